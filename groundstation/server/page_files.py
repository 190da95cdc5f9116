"""The built page: from the wheel, or from a checkout, or a text that says how to build it."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import PlainTextResponse
from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

HOW_TO_BUILD = (
    "The page is not built. In a checkout run:\n\n    cd web && npm ci && npm run build\n\n"
    "then reload. The API works without it: /docs\n"
)


def page_directory() -> Path | None:
    """Where the built page lies; None when it was never built."""
    package = Path(__file__).resolve().parent
    for directory in (package / "page", package.parents[1] / "web" / "dist"):
        if (directory / "index.html").is_file():
            return directory
    return None


class _Page(StaticFiles):
    """Static files; what carries its hash in the name never changes, the rest is asked for again."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """One file."""
        response = await super().get_response(path, scope)
        hashed = path.replace("\\", "/").startswith("assets/")
        response.headers["cache-control"] = "public, max-age=31536000, immutable" if hashed else "no-cache"
        return response


def install(app: FastAPI, directory: Path | None) -> None:
    """Serve the page at ``/``; to be called after all routes."""
    if directory is not None:
        app.mount("/", _Page(directory=directory, html=True), name="page")
        return

    @app.get("/", include_in_schema=False)
    async def not_built() -> PlainTextResponse:
        return PlainTextResponse(HOW_TO_BUILD, status_code=503)
