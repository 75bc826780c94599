"""What a client of the kill run takes for sound: a worker apart may be gone, and nothing else may refuse an image."""

from typing import Any

import httpx
import pytest

from lab.faults.callers import Caller
from tests import answers

GONE = "no worker is alive to describe the image: start one"


def met(caller: Caller, status: int, answer: dict[str, Any]) -> list[str]:
    """Violations after one call, which the service answers so; the calls after it find nobody."""
    replies = iter([httpx.Response(status, json=answer)])

    def handler(request: httpx.Request) -> httpx.Response:
        try:
            return next(replies)
        except StopIteration:
            raise httpx.ConnectError("gone") from None

    with httpx.Client(base_url="http://test", transport=httpx.MockTransport(handler)) as calls:
        caller.work_with(calls)
    return caller.violations


@pytest.mark.parametrize("seed", range(8))  # one image, and several
def test_a_worker_that_is_gone_may_be_the_reason_of_a_refusal(seed: int) -> None:
    caller = Caller(1, seed, worker_apart=True)

    assert met(caller, 503, answers.problem("unavailable", 503, detail=GONE)) == []
    assert caller.views == {}
    assert caller.counts["refused for want of a worker"] in (1, 3)


def test_any_other_reason_is_a_violation() -> None:
    full = answers.problem("unavailable", 503, detail="the database is away")

    assert "the database is away" in met(Caller(1, 1, worker_apart=True), 503, full)[0]


def test_where_the_service_describes_by_itself_no_image_may_be_refused() -> None:
    assert met(Caller(1, 1), 503, answers.problem("unavailable", 503, detail=GONE))
