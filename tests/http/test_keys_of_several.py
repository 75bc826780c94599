"""What several callers or several maps share: names of calls, and explained queries."""

from collections.abc import Iterator

import pytest

from tests.http.fakes import FakeRuntime
from tests.keys_in_memory import KeyMaker
from tests.openapi import CheckedClient
from tests.sample_images import photo


@pytest.fixture
def keys() -> KeyMaker:
    return KeyMaker()


@pytest.fixture
def runtime(keys: KeyMaker) -> FakeRuntime:
    return FakeRuntime(keys=keys.service)


@pytest.fixture
def client(runtime: FakeRuntime) -> Iterator[CheckedClient]:
    with CheckedClient(runtime.app()) as client:
        yield client


def test_drives_and_the_idempotency_keys_of_their_images_are_their_senders_own(
    runtime: FakeRuntime, client: CheckedClient, keys: KeyMaker
) -> None:
    """Two robots may call their drives alike, and count their images alike."""
    calls, drives = set(), set()
    for name in ("left", "right"):
        headers = {"content-type": "image/jpeg", "x-api-key": keys.make(name, "write"), "idempotency-key": "1"}
        client.post("/enroll?map=belfry", content=photo(), headers=headers)
        assert client.post("/query?map=belfry&drive=robot-7", content=photo(), headers=headers).status_code == 200
        calls.add(runtime.recogniser.given["call"])
        drives.add(runtime.recogniser.given["drive"])

    assert (len(calls), len(drives)) == (2, 2)


@pytest.mark.parametrize(("allowed", "status"), [(("belfry",), 404), (("belfry", "crypt"), 200)])
def test_an_explained_query_of_several_maps_needs_all_of_them(
    runtime: FakeRuntime,
    client: CheckedClient,
    keys: KeyMaker,
    monkeypatch: pytest.MonkeyPatch,
    allowed: tuple[str, ...],
    status: int,
) -> None:
    """What is drawn shows a view of one map beside a rival of another."""

    async def maps_of_query(query_id: str) -> tuple[str, ...]:
        return ("belfry", "crypt")

    async def explanation(query_id: str, view_id: str | None) -> bytes:
        return b"drawn"

    monkeypatch.setattr(runtime.recogniser, "maps_of_query", maps_of_query)
    monkeypatch.setattr(runtime.recogniser, "explanation", explanation)
    bearer = {"x-api-key": keys.make("visitor", "read", *allowed)}

    assert client.get("/queries/q1/explanation.png", headers=bearer).status_code == status
