"""Routes about the service itself: health, metrics, documentation."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST

from groundstation.server import metrics, rest
from groundstation.server.routes.common import HubDep, SourcesDep
from groundstation.server.wire import SCHEMA_VERSION

router = APIRouter()

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    "code,pre{font:14px/1.4 ui-monospace,monospace}pre{background:#f2f2f2;padding:.8rem;overflow:auto}"
    "dt{font-weight:600}"
)


@router.get("/api/v1/health", tags=["service"])
async def health(hub: HubDep, sources: SourcesDep) -> rest.Health:
    """Whether the station works."""
    picture = hub.picture
    checks = list(sources.health()) if sources.health else []
    return rest.Health(
        schema_version=SCHEMA_VERSION,
        server_time_ns=str(hub.clock()),
        status="ok" if all(check.ok for check in checks) else "degraded",
        version=sources.version,
        epoch=picture.epoch,
        seq=picture.seq,
        clients=len(hub.clients),
        vehicles=len(picture.vehicles),
        targets=len(picture.targets),
        connections=picture.connections.rows(),
        forwards=picture.forward_rows(),
        checks=checks,
    )


@router.get("/metrics", include_in_schema=False)
async def prometheus(hub: HubDep) -> Response:
    """Totals and gauges for Prometheus."""
    return Response(metrics.render(hub), media_type=CONTENT_TYPE_LATEST)


@router.get("/docs", include_in_schema=False)
async def docs(request: Request) -> HTMLResponse:
    """The API, readable, without anything from the network (the usual viewer is fetched from one)."""
    digest = base64.b64encode(hashlib.sha256(_STYLE.encode()).digest()).decode()
    policy = f"default-src 'none'; style-src 'sha256-{digest}'; frame-ancestors 'none'"
    return HTMLResponse(render_docs(request.app.openapi()), headers={"content-security-policy": policy})


def render_docs(openapi: dict[str, Any]) -> str:
    """An OpenAPI document as one plain page."""
    parts = [
        "<!doctype html><html lang=en><meta charset=utf-8><title>Ground station API</title>",
        f"<style>{_STYLE}</style><h1>{html.escape(openapi['info']['title'])}</h1>",
        "<p>Machine-readable: <a href=/openapi.json>openapi.json</a>. Live state: websocket ",
        "<code>/api/v1/stream</code> (<code>?since=EPOCH:SEQ</code> resumes). Totals: ",
        "<a href=/metrics>/metrics</a>.</p>",
    ]
    for path, operations in openapi["paths"].items():
        for method, operation in operations.items():
            parts.append(f"<h2><code>{method.upper()} {html.escape(path)}</code></h2>")
            parts.append(f"<p>{html.escape(operation.get('description', ''))}</p><ul>")
            parts.extend(
                f"<li><code>{html.escape(parameter['name'])}</code> ({parameter['in']}): "
                f"{html.escape(parameter.get('description', ''))}</li>"
                for parameter in operation.get("parameters", [])
            )
            parts.append(f"<li>answers: {', '.join(operation['responses'])}</li></ul>")
    parts.append("<h1>Values</h1>")
    for name, schema in openapi.get("components", {}).get("schemas", {}).items():
        parts.append(f"<h3>{html.escape(name)}</h3><p>{html.escape(schema.get('description', ''))}</p><dl>")
        for field, value in schema.get("properties", {}).items():
            parts.append(f"<dt><code>{html.escape(field)}</code></dt>")
            parts.append(f"<dd>{html.escape(value.get('description', ''))}</dd>")
        parts.append("</dl>")
    parts.append(f"<h1>Document</h1><pre>{html.escape(json.dumps(openapi, indent=1))}</pre>")
    return "".join(parts)
