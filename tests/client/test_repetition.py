"""What the client does where an answer is lost, late, cut or not the service's."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from revisit_client import ClientError, RevisitProblem, Unreachable

from tests import answers
from tests.client.test_client import Clock, Handler, client, refused

CLOSED = "[Errno 111] Connection refused"


def in_turn(*happens: Exception | httpx.Response) -> Handler:
    """Answers, or what breaks the connection, one a request."""
    left = list(happens)

    def handler(request: httpx.Request) -> httpx.Response:
        now = left.pop(0)
        if isinstance(now, Exception):
            raise now
        return now

    return handler


class Broken(httpx.SyncByteStream):
    """The beginning of a body, whose connection breaks then."""

    def __init__(self, *pieces: bytes) -> None:
        self._pieces = pieces

    def __iter__(self) -> Iterator[bytes]:
        yield from self._pieces
        raise httpx.ReadError("connection reset")


WHOLE, TAG = bytes(range(256)) * 40, '"7c1e"'


def parts(*pieces: int, tag: str = TAG) -> tuple[Handler, list[httpx.Request]]:
    """A service that gives a file by parts, of which so many bytes come before the connection breaks, one a request."""
    left, seen = list(pieces), list[httpx.Request]()

    def handler(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        begin = int(request.headers.get("range", "bytes=0-").removeprefix("bytes=").removesuffix("-"))
        headers = {"etag": tag, "accept-ranges": "bytes", "content-length": str(len(WHOLE) - begin)}
        if begin:
            headers["content-range"] = f"bytes {begin}-{len(WHOLE) - 1}/{len(WHOLE)}"
        rest = WHOLE[begin:]
        come = left.pop(0) if left else None
        body = httpx.ByteStream(rest) if come is None else Broken(rest[:come])
        return httpx.Response(206 if begin else 200, headers=headers, stream=body)

    return handler, seen


def test_a_download_goes_on_where_its_connection_broke(tmp_path: Path) -> None:
    clock, path = Clock(), tmp_path / "map.snapshot"
    handler, seen = parts(1000, 0, 0, 3000)

    assert client(handler, clock).download_snapshot("s1", path).read_bytes() == WHOLE

    assert [request.headers.get("range") for request in seen] == [None, *["bytes=1000-"] * 3, "bytes=4000-"]
    assert {request.headers["if-range"] for request in seen[1:]} == {TAG}
    assert clock.naps == [0.25, 0.5, 1.0, 0.25]
    assert list(tmp_path.iterdir()) == [path]


def test_two_downloads_to_one_path_are_not_mixed(tmp_path: Path) -> None:
    """Of a backup that still runs when the next one begins."""
    path = tmp_path / "map.snapshot"

    class Slow(httpx.SyncByteStream):
        def __iter__(self) -> Iterator[bytes]:
            yield b"first"
            second = httpx.ByteStream(b"second")
            client(lambda _: httpx.Response(200, stream=second)).download_snapshot("s2", path)
            yield b"first"

    with pytest.raises(FileExistsError):
        client(lambda _: httpx.Response(200, stream=Slow())).download_snapshot("s1", path)

    assert (path.read_bytes(), list(tmp_path.iterdir())) == (b"second", [path])


def test_a_download_waits_for_a_service_that_starts_again(tmp_path: Path) -> None:
    handler, _ = parts(5000)
    answers_ = iter([handler, lambda _: refused("unavailable", 503), handler])
    refuses = iter([False, True, False, False])

    def starting(request: httpx.Request) -> httpx.Response:
        if next(refuses):
            raise httpx.ConnectError(CLOSED)
        return next(answers_)(request)

    assert client(starting).download_snapshot("s1", tmp_path / "map").read_bytes() == WHOLE


def test_a_download_is_given_up_when_nothing_more_comes(tmp_path: Path) -> None:
    clock = Clock()
    handler, seen = parts(1000, *[0] * 99)

    with pytest.raises(Unreachable, match="connection reset"):
        client(handler, clock, patience=10).download_snapshot("s1", tmp_path / "map")

    assert (clock.now <= 10, len(seen) > 3, list(tmp_path.iterdir())) == (True, True, [])


@pytest.mark.parametrize(
    ("tag", "more"),
    [("", {}), (f"W/{TAG}", {}), (TAG, {"accept-ranges": "none"}), (TAG, {"content-range": "bytes 7-9/9"})],
)
def test_parts_of_what_may_be_another_file_are_not_put_together(tmp_path: Path, tag: str, more: dict[str, str]) -> None:
    handler, _ = parts(1000, tag=tag)

    def other(request: httpx.Request) -> httpx.Response:
        answer = handler(request)
        answer.headers.update(more)
        return answer

    with pytest.raises(Unreachable, match="connection reset"):
        client(other).download_snapshot("s1", tmp_path / "map")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_is_deleted_while_it_is_fetched_is_told(tmp_path: Path) -> None:
    handler, _ = parts(1000)
    turns = iter((True, False))

    def deleted(request: httpx.Request) -> httpx.Response:
        return handler(request) if next(turns) else refused("not-found", 404)

    with pytest.raises(RevisitProblem) as caught:
        client(deleted).download_snapshot("s1", tmp_path / "map")
    assert (caught.value.code, list(tmp_path.iterdir())) == ("not-found", [])


def test_what_must_not_be_done_twice_is_sent_again_where_nothing_was_sent() -> None:
    stopping, closed = refused("unavailable", 503), httpx.ConnectError(CLOSED)

    with pytest.raises(RevisitProblem, match="There is no such thing"):
        client(in_turn(stopping, closed, refused("not-found", 404))).make_snapshot("walk")
    with pytest.raises(Unreachable, match="connection reset"):
        client(in_turn(stopping, httpx.ReadError("connection reset"))).make_snapshot("walk")


def test_a_request_whose_answer_got_lost_is_repeated() -> None:
    tries: list[int] = []

    def handler(request: httpx.Request) -> httpx.Response:
        tries.append(1)
        if len(tries) == 1:
            raise httpx.ReadError("connection reset")
        return httpx.Response(201, json=answers.enrolled())

    assert client(handler).enroll(b"x").created


def test_an_image_of_a_drive_is_repeated_under_one_key_and_the_next_has_another() -> None:
    keys: list[str | None] = []

    def handler(request: httpx.Request) -> httpx.Response:
        keys.append(request.headers.get("idempotency-key"))
        if len(keys) == 1:
            raise httpx.ReadError("connection reset")
        return httpx.Response(200, json=answers.query_answer())

    for drive in ("robot-7", "robot-7", None):
        client(handler).query(b"x", drive=drive)
    assert keys[0] == keys[1] is not None
    assert keys[2] not in (keys[1], None)
    assert keys[3] is None


@pytest.mark.parametrize("folder", [False, True])
def test_a_recording_is_sent_again_from_its_beginning_to_a_service_that_was_starting(
    folder: bool, tmp_path: Path
) -> None:
    (tmp_path / "a.jpg").write_bytes(b"a photo")
    sent: list[bytes] = []

    def handler(request: httpx.Request) -> httpx.Response:
        sent.append(request.read())
        return httpx.Response(202, json=answers.job()) if len(sent) == 3 else refused("unavailable", 503)

    client(handler, Clock()).import_recording(tmp_path if folder else tmp_path / "a.jpg", map="campus")

    assert sent[0] == sent[1] == sent[2]
    assert b"a photo" in sent[2]


def test_an_answer_that_comes_once_all_is_stored_is_waited_for(tmp_path: Path) -> None:
    """A recording may go to an object store before that; a body that stands still is given up all the same."""
    seen: list[dict[str, float | None]] = []

    def handler(request: httpx.Request) -> httpx.Response:
        seen.append(request.extensions["timeout"])
        return httpx.Response(202, json=answers.job("waiting"))

    (tmp_path / "a.zip").write_bytes(b"zip")
    client(handler).import_recording(tmp_path / "a.zip", map="campus")
    with pytest.raises(ClientError):  # that is no map
        client(handler).restore(tmp_path / "a.zip")
    assert [(timeout["read"], timeout["write"]) for timeout in seen] == [(None, 60), (None, 60)]


def test_an_enrolment_whose_answer_got_lost_waits_for_the_first_that_still_runs() -> None:
    replayed = httpx.Response(201, json=answers.enrolled(), headers={"idempotent-replayed": "true"})
    handler = in_turn(httpx.ReadError("a proxy cut the answer"), refused("conflict", 409), replayed)

    assert client(handler).enroll(b"x").created


def test_a_conflict_of_the_enrolment_itself_is_told_after_a_lost_answer() -> None:
    replayed = refused("conflict", 409, **{"idempotent-replayed": "true"})

    with pytest.raises(RevisitProblem) as caught:
        client(in_turn(httpx.ReadTimeout("slow"), refused("conflict", 409), replayed)).enroll(b"x")

    assert caught.value.code == "conflict"


@pytest.mark.parametrize("named", ["0", "-3", "nan", "Thu, 01 Jan 2026 00:00:00 GMT"])
def test_a_time_to_wait_that_is_over_is_no_reason_to_call_without_a_pause(named: str) -> None:
    clock = Clock()
    with pytest.raises(RevisitProblem):
        client(lambda _: refused("too-many-requests", 429, **{"retry-after": named}), clock, patience=2).maps()
    assert clock.naps == [0.25, 0.5, 1.0]


def test_an_address_that_redirects_is_told_without_its_password() -> None:
    there = "https://me:secret@test/x?to=a@b"
    revisit = client(lambda _: httpx.Response(308, headers={"location": there}))
    with pytest.raises(RevisitProblem) as told:
        revisit.maps()
    assert "redirects to https://***@test/x; give that one" in str(told.value)
    assert "secret" not in str(told.value)


def test_an_address_that_redirects_is_told_and_taken_for_no_answer(tmp_path: Path) -> None:
    revisit = client(lambda _: httpx.Response(301, text="<html>moved</html>", headers={"location": "https://test/x"}))
    for call in (
        lambda: revisit.image("view"),
        lambda: revisit.maps(),
        lambda: revisit.download_snapshot("id", tmp_path / "map.snapshot"),
    ):
        with pytest.raises(RevisitProblem, match="redirects to https://test/x"):
            call()
    assert list(tmp_path.iterdir()) == []


def test_an_answer_that_cannot_be_unpacked_is_not_revisits() -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        return httpx.Response(200, headers={"content-encoding": "gzip"}, stream=httpx.ByteStream(b"no gzip"))

    with pytest.raises(ClientError, match="not revisit's"):
        client(handler).maps()


def test_a_deletion_whose_answer_got_lost_may_have_been_done() -> None:
    with pytest.raises(RevisitProblem, match="it may have been deleted by this very call") as told:
        client(in_turn(httpx.ReadError("reset"), refused("not-found", 404)), Clock()).delete("v1")
    assert told.value.code == "not-found"

    with pytest.raises(RevisitProblem) as told:
        client(in_turn(refused("not-found", 404)), Clock()).delete("v1")
    assert "this very call" not in str(told.value)


def test_a_request_that_would_be_done_twice_is_not_repeated_when_its_answer_was_lost() -> None:
    tries: list[int] = []

    def handler(request: httpx.Request) -> httpx.Response:
        tries.append(1)
        raise httpx.ReadError("connection reset")

    with pytest.raises(Unreachable):
        client(handler).train_vocabulary("default")

    assert len(tries) == 1
