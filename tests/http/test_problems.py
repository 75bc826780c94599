"""Errors as problems."""

import json

import pytest

from app.http.problems import code_of, problem_of
from schemas.errors import Busy, DescriptorMismatch, InvalidParameters, LeaseLost, NotFound, RevisitError, SetupError


@pytest.mark.parametrize(
    ("error", "code", "status"),
    [
        (NotFound("map", "m"), "not-found", 404),
        (InvalidParameters.of("top", "is 0"), "invalid-parameter", 422),
        # In a running service a SetupError concerns one map; its text says what to do.
        (SetupError("this recipe needs the encoder lseg; start that one"), "conflict", 409),
        # Errors between workers mean nothing to a client.
        (LeaseLost("secret"), "internal", 500),
        (DescriptorMismatch(got=1, want=2), "internal", 500),
        (RevisitError("secret"), "internal", 500),
    ],
)
def test_a_refusal_has_its_code_and_tells_no_secrets(error: RevisitError, code: str, status: int) -> None:
    response = problem_of(error, "r1")
    body = json.loads(bytes(response.body))
    assert (code_of(error), response.status_code) == (code, status)
    assert (body["type"], body["status"], body["request_id"]) == (f"urn:revisit:problem:{code}", status, "r1")
    assert "secret" not in body["detail"]


def test_busy_says_when_to_try_again() -> None:
    assert problem_of(Busy("full", 17), "r1").headers["retry-after"] == "17"
