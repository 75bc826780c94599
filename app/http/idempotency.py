"""Idempotency-Key: a repeated call is done once and gets the same answer again."""

import hashlib
import json
import logging
import re
from collections.abc import Awaitable, Callable, Sequence
from typing import Any

from fastapi import Request
from fastapi.responses import Response

from app.http.curate import Curator
from app.http.problems import problem_of, request_id
from schemas.errors import Cancelled, InvalidParameters, RevisitError
from schemas.keys import Access
from schemas.records import Replay

logger = logging.getLogger("revisit.http")


HEADER = "Idempotency-Key"
REPLAYED = "Idempotent-Replayed"

_KEY = re.compile(r"[\x21-\x7e]{1,255}")
_KEPT_HEADERS = ("content-type", "location")


def header(description: str) -> dict[str, Any]:
    """The header as OpenAPI documents it."""
    schema = {"type": "string", "minLength": 1, "maxLength": 255}
    return {"name": HEADER, "in": "header", "required": False, "description": description, "schema": schema}


def key_of(request: Request, access: Access) -> str | None:
    """The request's Idempotency-Key, as the caller's own; None without one.

    Nobody can be answered, or refused, for another's key.

    Raises
    ------
    InvalidParameters
        It is repeated or malformed.
    """
    keys = request.headers.getlist(HEADER)
    if not keys:
        return None
    if len(keys) > 1 or not _KEY.fullmatch(keys[0]):
        raise InvalidParameters.of(HEADER, "needs to be one value of 1 to 255 visible ASCII characters")
    return access.own(keys[0])


def fingerprint(images: Sequence[bytes], parameters: Sequence[tuple[str, str]]) -> str:
    """SHA-256 (hexadecimal) over the images, in order, and the parameters, in any order."""
    whole = hashlib.sha256()
    for image in images:
        whole.update(hashlib.sha256(image).digest())
    whole.update(json.dumps(sorted(parameters)).encode())
    return whole.hexdigest()


async def once(
    curator: Curator, request: Request, key: str, print_: str, work: Callable[[], Awaitable[Response]]
) -> Response:
    """Do the work, or repeat the answer that a call with this key got.

    4xx answers are repeated too. 429 and 5xx are forgotten, so that the caller can try again, and so is an answer with
    Retry-After, since a part of its work was put off, or that of a description that somebody cancelled.

    Parameters
    ----------
    curator : Curator
        Keeps the answers.
    request : Request
    key : str
        From `key_of`.
    print_ : str
        The request's `fingerprint`.
    work : callable
        Does the work and returns the answer.

    Raises
    ------
    Conflict
        The call with this key still runs.
    KeyReused
        The key belongs to another request.
    """
    replay = await curator.begin_call(key, print_)
    if replay is not None:
        return Response(replay.body, replay.status, {**replay.headers, REPLAYED: "true"})
    put_off = False
    try:
        try:
            response = await work()
        except RevisitError as error:
            response = problem_of(error, request_id(request))
            put_off = isinstance(error, Cancelled)
    except BaseException:
        await _abandon(curator, key)
        raise
    if put_off or response.status_code >= 500 or response.status_code == 429 or "retry-after" in response.headers:
        await _abandon(curator, key)
        return response
    kept = {name: response.headers[name] for name in _KEPT_HEADERS if name in response.headers}
    try:
        await curator.end_call(key, Replay(response.status_code, kept, bytes(response.body)))
    except RevisitError as error:
        # The work is done and durable; only its answer could not be remembered, so it is no failure.
        logger.warning("answer not remembered: %s", error, extra={"event": "answer_not_remembered"})
    return response


async def _abandon(curator: Curator, key: str) -> None:
    """Forget a call that failed; where that cannot be stored now, the answer to the caller says why it failed."""
    try:
        await curator.abandon_call(key)
    except RevisitError as error:
        logger.warning("a call that failed is forgotten later: %s", error, extra={"event": "call_not_forgotten"})
