"""RFC 9457 problem documents: every refusal over HTTP is one line that says what is needed."""

from __future__ import annotations

import logging
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from groundstation.domain.errors import GroundstationError, InputError, PeerError, ResourceError

MEDIA_TYPE = "application/problem+json"
logger = logging.getLogger(__name__)


class ProblemError(Exception):
    """A refusal that a route decided on."""

    def __init__(self, status: HTTPStatus, kind: str, detail: str) -> None:
        """``kind`` is stable, for machines; ``detail`` is one line, for people."""
        super().__init__(detail)
        self.status = status
        self.kind = kind
        self.detail = detail


def problem(status: int, kind: str, detail: str, headers: dict[str, str] | None = None) -> JSONResponse:
    """The answer itself."""
    return JSONResponse(
        {
            "type": f"urn:groundstation:problem:{kind}",
            "title": HTTPStatus(status).phrase,
            "status": status,
            "detail": " ".join(detail.split()),
        },
        status_code=status,
        media_type=MEDIA_TYPE,
        headers=headers,
    )


def validation_line(error: RequestValidationError) -> str:
    """All faults of a request in one line: where, what is needed, what was seen."""
    faults = []
    for fault in error.errors()[:5]:
        where = ".".join(str(part) for part in fault["loc"])
        seen = repr(fault.get("input"))
        faults.append(f"{where}: {fault['msg']} (got {seen if len(seen) <= 60 else seen[:57] + '...'})")
    return "; ".join(faults)


def install(app: FastAPI) -> None:
    """Make every error of ``app`` a problem document."""

    @app.exception_handler(ProblemError)
    async def on_problem(_request: Request, error: ProblemError) -> Response:
        return problem(error.status, error.kind, error.detail)

    @app.exception_handler(RequestValidationError)
    async def on_invalid(_request: Request, error: RequestValidationError) -> Response:
        return problem(HTTPStatus.UNPROCESSABLE_ENTITY, "invalid-request", validation_line(error))

    @app.exception_handler(HTTPException)
    async def on_http(request: Request, error: HTTPException) -> Response:
        detail = f"{request.method} {request.url.path}: {error.detail}"
        headers = dict(error.headers) if error.headers else None
        return problem(error.status_code, "http", detail, headers)

    @app.exception_handler(GroundstationError)
    async def on_own(_request: Request, error: GroundstationError) -> Response:
        if isinstance(error, InputError):
            return problem(HTTPStatus.UNPROCESSABLE_ENTITY, "input", str(error))
        if isinstance(error, PeerError):
            return problem(HTTPStatus.CONFLICT, "peer", str(error))
        if isinstance(error, ResourceError):
            return problem(HTTPStatus.SERVICE_UNAVAILABLE, "resource", str(error))
        logger.error("internal error on a request: %s", error)
        return problem(HTTPStatus.INTERNAL_SERVER_ERROR, "internal", str(error))

    @app.exception_handler(Exception)
    async def on_fault(_request: Request, error: Exception) -> Response:
        logger.error("unexpected fault on a request", exc_info=error)
        return problem(
            HTTPStatus.INTERNAL_SERVER_ERROR,
            "internal",
            f"an internal fault ({type(error).__name__}); the log has the details, please report it",
        )
