"""An encoder fails on every image or hangs, as on a GPU that is lost: its process ends, and no photo is given up."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.stories.running import ROOT, RunningEncoder, RunningService, variables, worker
from tests.waiting import PATIENCE_S, until

pytestmark = pytest.mark.one_database("what a worker does with its images is the same on both")

PHOTOS = 3

ILL = """
import sys, threading
import worker
import app.cli.serve, app.http.server, worker.description.blame, worker.description.scheduler
from app.cli.__main__ import main
from worker.encoders.color import ColorEncoder
from worker.encoders.compact.encoder import CompactEncoder

def fails(self, images, *, urgent=False):
    raise RuntimeError("CUDA error: an illegal memory access was encountered")

def hangs(self, images, *, urgent=False):
    print("it hangs", flush=True)
    threading.Event().wait()

ColorEncoder.encode = CompactEncoder.encode = {how}
app.cli.serve.LOOK_EVERY_S = app.http.server.LOOK_EVERY_S = 0.1
app.http.server.PARTING_S = 2
worker.description.blame.REST_S = 0
worker.description.scheduler.HOPELESS_S = worker.description.scheduler.HANGS_S = {after_s}
sys.exit(main(sys.argv[-1:]))
"""
"""A process of revisit whose encoder fails or hangs; it counts as beyond help after some seconds."""

LEASE = {"REVISIT_LEASE_S": "600"}
"""The same for all: no job goes back because a lease has ended."""


@contextmanager
def ill_worker(data: Path, how: str, after_s: float) -> Iterator["subprocess.Popen[str]"]:
    """A worker of that kind."""
    process = subprocess.Popen(
        [sys.executable, "-c", ILL.format(how=how, after_s=after_s), "worker"],
        env=variables(data, LEASE),
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


class Failing(RunningService):
    """A service of that kind."""

    within = (sys.executable, "-c", ILL.format(how="fails", after_s=3))


class Hanging(RunningService):
    """Another."""

    within = (sys.executable, "-c", ILL.format(how="hangs", after_s=3))


class FailingEncoder(RunningEncoder):
    """An encoder for several nodes."""

    within = Failing.within


@pytest.fixture
def client(tmp_path: Path) -> Iterator[httpx.Client]:
    """Of a service that has no worker, and photos that wait for one."""
    with (
        RunningService(tmp_path, False, REVISIT_INLINE_WORKER="false", **LEASE) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        enrol_photos(client)
        yield client


def enrol_photos(client: httpx.Client) -> None:
    for number in range(PHOTOS):
        where = f"/enroll?map=quay&place=spot-{number}&wait=0"
        taken = client.post(where, content=photo(number), headers={"content-type": "image/jpeg"})
        assert taken.status_code == 202


def views(client: httpx.Client) -> dict[str, int]:
    counts: dict[str, int] = client.get("/maps/quay").json()["views"]
    return counts


@pytest.mark.parametrize(
    ("how", "why", "times"),
    [("fails", "the encoder has failed on every image for", 4), ("hangs", "the encoder has been at one image for", 1)],
)
def test_a_worker_that_can_describe_nothing_ends_and_another_describes_them(
    client: httpx.Client, tmp_path: Path, how: str, why: str, times: int
) -> None:
    """However often it is started anew: an image that three workers died of would be given up."""
    for _ in range(times):
        with ill_worker(tmp_path, how, 0.5) as process:
            said = process.communicate(timeout=PATIENCE_S)[0]

        assert process.returncode == 1, said
        assert f"ends, so that it is started anew: {why}" in said
        assert ("illegal memory access" in said) == (how == "fails")
    assert views(client) == {"pending": PHOTOS, "ready": 0, "failed": 0}
    jobs = client.get("/jobs?map=quay").json()["jobs"]
    assert [(job["state"], job["attempts"]) for job in jobs] == [("waiting", 0)] * PHOTOS, "it put them back itself"
    with worker(tmp_path, **LEASE):
        until(lambda: views(client)["ready"] == PHOTOS)


def test_a_worker_whose_encoder_hangs_ends_at_a_second_signal(client: httpx.Client, tmp_path: Path) -> None:
    with ill_worker(tmp_path, "hangs", 3600) as process:
        assert process.stdout is not None
        assert any("it hangs" in line for line in process.stdout)
        process.send_signal(signal.SIGTERM)
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(2)
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=10)

    assert process.returncode == 1
    assert "stopped at once by a second SIGTERM" in said
    with worker(tmp_path, **LEASE):
        until(lambda: views(client)["ready"] == PHOTOS)


@pytest.mark.parametrize(
    ("kind", "why"),
    [(Failing, "the encoder has failed on every image for"), (Hanging, "the encoder has been at one image for")],
)
def test_a_service_that_can_describe_nothing_ends_and_the_next_one_describes_what_it_took(
    tmp_path: Path, kind: type[RunningService], why: str
) -> None:
    with kind(tmp_path, False) as service:
        with httpx.Client(base_url=service.url, timeout=60) as client:
            enrol_photos(client)

        assert service.wait() == 1
    said = "".join(service.output)
    assert f"ends, so that it is started anew: {why}" in said
    with RunningService(tmp_path) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        until(lambda: views(client) == {"pending": 0, "ready": PHOTOS, "failed": 0})


def test_the_first_signal_to_a_service_that_ends_by_itself_is_no_second_one(tmp_path: Path) -> None:
    """A supervisor that stops it just then: whoever waits is answered, and the log says what happened."""
    with Hanging(tmp_path, False) as service:
        with httpx.Client(base_url=service.url, timeout=60) as client:
            enrol_photos(client)
        until(lambda: any("ends, so that it is started anew" in line for line in service.output))
        service.signal(signal.SIGTERM)

        assert service.wait() == 1
    assert "by a second" not in "".join(service.output)


def test_a_shared_encoder_that_can_encode_nothing_ends() -> None:
    with FailingEncoder(0, False) as encoder:
        assert httpx.get(f"{encoder.url}/readyz", timeout=60).status_code == 503

        assert encoder.wait() == 1
    assert "ends, so that it is started anew: the encoder has failed on every image for" in "".join(encoder.output)
