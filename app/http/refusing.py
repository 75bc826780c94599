"""Refuses a request without reading its body; for middleware."""

from starlette.requests import Request
from starlette.types import Receive, Scope, Send

from app.http.problems import problem_of, request_id
from schemas.errors import RevisitError


async def refuse(error: RevisitError, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer a request with an error's problem and close the connection.

    The body may be unread: a client that asked with ``Expect: 100-continue`` never sends it, and what others send is
    thrown away by `app.http.connection`, within bounds, so that they see the answer instead of a reset.

    Parameters
    ----------
    error : RevisitError
        `Busy` and its kinds give ``Retry-After``.
    scope, receive, send
        As the middleware got them, inside `app.http.middleware.RequestContext`.
    """
    response = problem_of(error, request_id(Request(scope)))
    response.headers["Connection"] = "close"
    await response(scope, receive, send)
