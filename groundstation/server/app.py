"""Composes the web application. It starts nothing: ``serve`` and ``Hub.run`` do."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI

from groundstation.server import page_files, problems, stream
from groundstation.server.access import Access
from groundstation.server.actions import Actions, Sources
from groundstation.server.hub import Hub
from groundstation.server.picture import Picture
from groundstation.server.routes import operator, service, state

_FIND = Path()
"""Stands for: look where the page usually is."""


def create_app(
    hub: Hub | Picture,
    actions: Actions,
    sources: Sources | None = None,
    page_directory: Path | None = _FIND,
) -> FastAPI:
    """The application of one station.

    Given a Picture it makes a hub of its own (``app.state.hub``), on the wall clock. Someone
    must run ``app.state.hub.run()`` for the stream to move. ``page_directory=None`` serves
    no page.
    """
    if isinstance(hub, Picture):
        hub = Hub(hub)
    sources = sources or Sources()
    app = FastAPI(title="Ground station", version=sources.version, docs_url=None, redoc_url=None)
    app.state.hub = hub
    app.state.actions = actions
    app.state.sources = sources
    problems.install(app)
    app.add_middleware(
        Access,
        allowed_names=hub.settings.allowed_hosts,
        body_limit_bytes=hub.settings.body_limit_bytes,
    )
    for router in (state.router, operator.router, service.router, stream.router):
        app.include_router(router)
    page_files.install(app, page_files.page_directory() if page_directory is _FIND else page_directory)
    return app
