"""SIGTERM under load: every caller gets an answer with a type, none a reset, and a second signal stops at once."""

import signal
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import httpx
import psutil

from tests.sample_images import drawn, encoded
from tests.stories.raw import answers, connect, read_all, read_one
from tests.stories.running import RunningService, worker

JPEG = {"content-type": "image/jpeg"}
NO_WORKER = {"REVISIT_INLINE_WORKER": "false"}


def image(seed: int) -> bytes:
    return encoded(drawn(96, 64, seed), "jpeg")


def waiting_jobs(service: RunningService) -> int:
    return len(httpx.get(f"{service.url}/jobs?state=waiting&limit=500").json()["jobs"])


def check(answer: httpx.Response, *statuses: int) -> None:
    """One of these statuses, or 503 as a whole problem."""
    assert answer.status_code in (*statuses, 503), answer.text
    if answer.status_code == 503:
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["type"] == "urn:revisit:problem:unavailable"
        assert int(answer.headers["retry-after"]) > 0
    assert answer.headers["connection"] == "close"


def begin_query(connection: socket.socket) -> bytes:
    """Send a part of a query, which is under way from then on; returns the rest."""
    body = image(0)
    connection.sendall(b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\n")
    connection.sendall(b"Content-Length: %d\r\n\r\n" % len(body) + body[:100])
    return body[100:]


def test_enrolments_that_wait_are_answered_at_once_and_kept(tmp_path: Path) -> None:
    """The only worker hangs: all wait. The stop wakes them, and what 202 acknowledged is there after it."""
    callers = 100
    with (
        # The worker first: with so long a lease the service looks for workers at its start and then every two minutes.
        worker(tmp_path, REVISIT_LEASE_S="600") as describing,
        RunningService(tmp_path, False, **NO_WORKER, REVISIT_WAIT="600", REVISIT_LEASE_S="600") as service,
        ThreadPoolExecutor(callers) as threads,
    ):
        first = httpx.post(f"{service.url}/enroll", content=image(callers), headers=JPEG, timeout=60)
        assert first.status_code == 201, first.text
        describing.send_signal(signal.SIGSTOP)

        def enroll(seed: int) -> httpx.Response:
            return httpx.post(f"{service.url}/enroll", content=image(seed), headers=JPEG, timeout=60)

        calls = [threads.submit(enroll, seed) for seed in range(callers)]
        while waiting_jobs(service) < callers:
            assert not any(call.done() for call in calls)
        begin = time.monotonic()
        service.signal(signal.SIGTERM)
        for call in calls:
            answer = call.result()
            check(answer, 202)
            assert answer.status_code == 202
            assert answer.headers["location"] == f"/jobs/{answer.json()['job']}"
        assert time.monotonic() - begin < 10
        assert service.wait() == 0

    with RunningService(tmp_path, False, **NO_WORKER) as service:
        assert waiting_jobs(service) == callers


def test_queries_before_and_after_the_signal_are_answered(tmp_path: Path) -> None:
    """Thirty queries are on their way; as many come while the service drains, on connections that it kept open."""
    with ExitStack() as connections, RunningService(tmp_path) as service, ThreadPoolExecutor(30) as threads:
        assert httpx.post(f"{service.url}/enroll", content=image(0), headers=JPEG, timeout=60).status_code == 201
        # One request holds the drain open: its body is not complete.
        held = connections.enter_context(connect(service))
        rest = begin_query(held)

        def query(_: int) -> httpx.Response:
            return httpx.post(f"{service.url}/query", content=image(0), headers=JPEG, timeout=60)

        before = [threads.submit(query, n) for n in range(30)]
        kept = [connections.enter_context(connect(service)) for _ in range(5)]
        for connection in kept:
            connection.sendall(b"GET /livez HTTP/1.1\r\nHost: a\r\n\r\n")
            assert read_one(connection).status == 200
        service.signal(signal.SIGTERM)
        while httpx.get(f"{service.url}/readyz").json()["checks"] != {"service": "stopping"}:
            pass
        for connection in kept:
            connection.sendall(b"GET /maps HTTP/1.1\r\nHost: a\r\n\r\n")
            (answer,) = answers(read_all(connection))
            assert (answer.status, answer.problem(), answer.headers["connection"]) == (503, "unavailable", "close")
        after = [threads.submit(query, n) for n in range(30)]
        for call in before:
            assert call.result().status_code in (200, 503)
        for call in after:
            check(call.result())
        assert httpx.get(f"{service.url}/livez").status_code == 200
        held.sendall(rest)
        (answer,) = answers(read_all(held))
        assert answer.status == 200
        assert service.wait() == 0


def test_callers_that_never_cease_are_answered_until_nobody_can_connect(tmp_path: Path) -> None:
    """Each calls again at once, on new and on kept connections, until its connection is refused; none is reset."""
    with RunningService(tmp_path) as service, connect(service) as held, ThreadPoolExecutor(12) as threads:
        stopping, told = threading.Event(), threading.Event()
        rest = begin_query(held)  # without it the service may be gone before anybody calls

        def call_again(keeps: bool) -> tuple[int, int]:
            answered = refused = 0
            while True:
                with httpx.Client(timeout=60) as client:
                    try:
                        for _ in range(5 if keeps else 1):
                            answer = client.post(f"{service.url}/query?map=none", content=image(0), headers=JPEG)
                            assert answer.status_code in (404, 503), answer.text
                            assert answer.headers["content-type"] == "application/problem+json"
                            answered += 1
                            if answer.status_code == 503:
                                refused += 1
                                told.set()
                    except httpx.ConnectError:
                        assert stopping.is_set()
                        return answered, refused

        calls = [threads.submit(call_again, bool(n % 2)) for n in range(12)]
        while httpx.get(f"{service.url}/readyz").status_code != 200:
            pass
        stopping.set()
        service.signal(signal.SIGTERM)
        assert told.wait(60)
        held.sendall(rest)
        (answer,) = answers(read_all(held))
        assert (answer.status, answer.problem()) == (404, "not-found")  # nothing is enrolled
        counts = [call.result() for call in calls]
        assert service.wait() == 0
        assert sum(refused for _, refused in counts) > 0


def test_what_is_not_done_in_time_is_told_so(tmp_path: Path) -> None:
    with RunningService(tmp_path, REVISIT_GRACE_S="1") as service:
        with connect(service) as held:
            held.sendall(b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Type: image/jpeg\r\nContent-Length: 9\r\n\r\nx")
            while not answered_readiness(service):
                pass
            service.signal(signal.SIGTERM)
            (answer,) = answers(read_all(held))
        assert (answer.status, answer.problem(), answer.headers["connection"]) == (503, "unavailable", "close")
        assert service.wait() == 0


def answered_readiness(service: RunningService) -> bool:
    return httpx.get(f"{service.url}/readyz").status_code == 200


def test_a_second_signal_stops_at_once(tmp_path: Path) -> None:
    for second in (signal.SIGTERM, signal.SIGINT):
        with RunningService(tmp_path, REVISIT_GRACE_S="60") as service, connect(service) as held:
            held.sendall(b"POST /query HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\nx")
            assert answered_readiness(service)
            service.signal(signal.SIGTERM)
            while httpx.get(f"{service.url}/readyz").status_code == 200:
                pass
            begin = time.monotonic()
            service.signal(second)
            assert service.wait(20) == 1
            assert time.monotonic() - begin < 5
            (answer,) = answers(read_all(held))
            assert answer.problem() == "unavailable"


def test_a_second_signal_stops_at_once_while_the_service_waits_for_work_that_hangs(tmp_path: Path) -> None:
    """No request is left by then: it waits for its decoder, in which an image hangs."""
    patient = {"REVISIT_GRACE_S": "0.5", "REVISIT_DECODE_S": "90"}
    with RunningService(tmp_path, **patient) as service, connect(service) as held:
        httpx.post(f"{service.url}/enroll", content=image(0), headers=JPEG, timeout=60).raise_for_status()
        (decoder,) = psutil.Process(service.pid).children()
        decoder.suspend()
        held.sendall(begin_query(held))
        service.signal(signal.SIGTERM)
        (answer,) = answers(read_all(held))
        assert answer.problem() == "unavailable"
        time.sleep(0.5)
        begin = time.monotonic()
        service.signal(signal.SIGTERM)
        assert service.wait(20) == 1
        assert time.monotonic() - begin < 5
        decoder.resume()
        decoder.wait(10)
