"""Names, ids and lists from anywhere, as the client writes them into addresses."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import timedelta
from typing import Any

import httpx
import pytest
from revisit_client import Revisit, RevisitProblem

from tests import answers


def sent(call: Callable[[Revisit], object]) -> list[httpx.URL]:
    """The addresses of the requests of a call, which the service refuses."""
    seen: list[httpx.URL] = []

    def handler(request: httpx.Request) -> httpx.Response:
        seen.append(request.url)
        return httpx.Response(404, json=answers.problem("not-found", 404))

    with Revisit("http://test", transport=httpx.MockTransport(handler)) as revisit, suppress(RevisitProblem):
        call(revisit)
    return seen


CALLS: Sequence[Callable[[Revisit, str], Any]] = (
    lambda revisit, name: revisit.delete(name),
    lambda revisit, name: revisit.view(name),
    lambda revisit, name: revisit.delete_map(name),
    lambda revisit, name: revisit.job(name),
    lambda revisit, name: revisit.image(name),
    lambda revisit, name: revisit.health(name),
    lambda revisit, name: revisit.name_unknown(name, name, place="hall"),
    lambda revisit, name: revisit.delete_snapshot(name),
    lambda revisit, name: revisit.import_recording(__file__, map=name),
)


@pytest.mark.parametrize("name", ["../maps/campus", "a/../../maps/campus", "..\\maps", "a?all=true#b", "%2e%2e"])
def test_no_id_leads_to_another_address(name: str) -> None:
    """`delete("../maps/campus")` is no way to delete a map: ids come from links, tables and people."""
    for call in CALLS:
        for url in sent(lambda revisit, call=call: call(revisit, name)):  # type: ignore[misc]
            assert url.raw_path.count(b"/") <= 4
            assert b".." not in url.raw_path.split(b"/")
            assert (b"?" in url.raw_path, name in url.path) == (False, True)


@pytest.mark.parametrize("name", ["", ".", "..", "caf\udce9"])
def test_what_is_no_id_is_not_sent(name: str) -> None:
    for call in CALLS:
        with pytest.raises(ValueError, match="neither a name nor an id"):
            sent(lambda revisit, call=call: call(revisit, name))  # type: ignore[misc]


def test_lists_may_be_given_as_the_service_writes_them() -> None:
    """A text is a sequence too: its letters are no list."""
    text: Any = "1,2,3"
    (url,) = sent(lambda revisit: list(revisit.views(map="m", near=text, exclude=text)))
    assert (url.params["near"], url.params["exclude"]) == (text, text)
    (url,) = sent(lambda revisit: revisit.preview_dynamic("m", text))
    assert url.params["dynamic"] == text


def test_a_filter_by_nothing_does_not_become_no_filter() -> None:
    """`metadata={"batch": job.get("batch")}` beside a place would delete all of the place."""
    nothing: Any = {"floor": 2, "batch": None}
    for call in (
        lambda revisit: revisit.delete_views("m", place="hall", metadata=nothing),
        lambda revisit: list(revisit.views(map="m", metadata=nothing)),
        lambda revisit: revisit.query(b"x", metadata=nothing),
    ):
        with pytest.raises(ValueError, match="metadata 'batch' is None"):
            sent(call)


@pytest.mark.parametrize(
    ("span", "text"),
    [
        (timedelta(seconds=30), "30s"),
        (timedelta(seconds=0.5), "0.5s"),
        (timedelta(days=20, microseconds=1), "1728000.000001s"),
        (timedelta(0), "0s"),
    ],
)
def test_seconds_are_written_in_full(span: timedelta, text: str) -> None:
    (url,) = sent(lambda revisit: list(revisit.views(map="m", exclude_last=span)))
    assert url.params["exclude_last"] == text
