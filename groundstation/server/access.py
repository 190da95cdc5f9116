"""Who may talk to the server: this machine's own pages, and nobody else's.

Two attacks reach a server on loopback through the operator's own browser: a foreign site
that posts to it (cross-site request), and a foreign name that is made to resolve to
127.0.0.1 (DNS rebinding). Rule: the Host must be an IP address, ``localhost`` or a name
from the settings (rebinding needs a name of the attacker's), and where the browser says
where a request comes from (Origin, Sec-Fetch-Site) that must be this very page.
"""

from __future__ import annotations

import ipaddress
from http import HTTPStatus
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from groundstation.server.problems import problem

CONTENT_SECURITY_POLICY = (
    "default-src 'self'; img-src 'self' data: blob:; worker-src 'self' blob:; style-src 'self'; "
    "script-src 'self'; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_SAFE_METHODS = ("GET", "HEAD", "OPTIONS")


def host_allowed(host: str, allowed_names: tuple[str, ...]) -> bool:
    """Whether a Host header may be answered."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name == "localhost" or name in {allowed.lower() for allowed in allowed_names}
    return True


def origin_allowed(origin: str, host: str) -> bool:
    """Whether a page at ``origin`` is the page that this server serves at ``host``."""
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in {"http", "https"} and parts.netloc.lower() == host.lower()


def refusal(scope: Scope, allowed_names: tuple[str, ...]) -> str | None:
    """Why the request is refused, one line; None when it may pass."""
    headers = Headers(scope=scope)
    host = headers.get("host", "")
    if not host_allowed(host, allowed_names):
        return (
            f"the Host {host!r} is not this station's; open it by IP address or localhost, "
            "or add the name to the server's allowed hosts"
        )
    if scope["type"] == "http" and scope["method"] in _SAFE_METHODS:
        return None
    origin = headers.get("origin")
    if origin is not None and not origin_allowed(origin, host):
        return f"a page at {origin!r} may not act on this station; only its own page at {host!r} may"
    if origin is None and headers.get("sec-fetch-site", "same-origin") not in {"same-origin", "none"}:
        return "a page of another site may not act on this station; only its own page may"
    return None


class Access:
    """ASGI middleware: refuses by ``refusal``, bounds bodies, adds security headers."""

    def __init__(self, app: ASGIApp, allowed_names: tuple[str, ...], body_limit_bytes: int) -> None:
        self._app = app
        self._allowed_names = allowed_names
        self._body_limit_bytes = body_limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass, or answer with a problem document."""
        if scope["type"] not in {"http", "websocket"}:
            await self._app(scope, receive, send)
            return
        why = refusal(scope, self._allowed_names)
        if why is not None:
            # Before a websocket is accepted a plain HTTP answer refuses it.
            await problem(HTTPStatus.FORBIDDEN, "foreign-request", why)(scope, receive, send)
            return
        if scope["type"] == "websocket":
            await self._app(scope, receive, send)
            return
        length = Headers(scope=scope).get("content-length", "0")
        if not length.isdecimal() or int(length) > self._body_limit_bytes:
            detail = f"a body of {length} bytes; at most {self._body_limit_bytes} are taken"
            answer = problem(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body-too-large", detail)
            await answer(scope, receive, send)
            return
        await self._app(scope, self._bounded(receive), _with_headers(send))

    def _bounded(self, receive: Receive) -> Receive:
        seen = 0

        async def bounded() -> Message:
            nonlocal seen
            message = await receive()
            if message["type"] == "http.request":
                seen += len(message.get("body", b""))
                if seen > self._body_limit_bytes:
                    # A chunked body has no length to refuse beforehand.
                    raise HTTPException(
                        HTTPStatus.REQUEST_ENTITY_TOO_LARGE,
                        f"a body of more than {self._body_limit_bytes} bytes, which is the limit",
                    )
            return message

        return bounded


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            names = {name.lower() for name, _value in message["headers"]}
            extra = {
                b"content-security-policy": CONTENT_SECURITY_POLICY.encode(),
                b"x-content-type-options": b"nosniff",
                b"referrer-policy": b"no-referrer",
                b"cross-origin-opener-policy": b"same-origin",
                b"cross-origin-resource-policy": b"same-origin",
            }
            message["headers"] = [
                *message["headers"],
                *((name, value) for name, value in extra.items() if name not in names),
            ]
        await send(message)

    return sending
