"""Decoding apart: a picture that ends its decoder ends nothing else."""

import io
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime

import numpy as np
import pytest
from PIL import Image as PilImage

from schemas.errors import BadImage, BodyTooLarge, Busy, Unavailable
from tests.conftest import ROOT
from tests.sample_images import drawn, encoded, photo
from tests.waiting import until
from worker.description.priority import step_aside
from worker.images.apart import process as process_module
from worker.images.apart.pool import DecoderPool
from worker.images.apart.process import DecoderProcess
from worker.images.codec import Limits, decode, thumbnail
from worker.images.decoder import InProcessDecoder
from worker.images.exif import read_exif

LIMITS = Limits(max_bytes=5_000_000, max_pixels=1_000_000)


@pytest.fixture
def pool() -> Iterator[DecoderPool]:
    opened = DecoderPool(2, LIMITS, deadline_s=20)
    opened.start()
    yield opened
    opened.close()


def pid_of(process: DecoderProcess) -> int:
    assert process.pid is not None
    return process.pid


@pytest.mark.parametrize("side", [1100, 2600])  # more pixels than are taken, and more bytes as well
def test_a_stored_image_may_be_larger_than_one_that_is_sent(pool: DecoderPool, side: int) -> None:
    data = encoded(np.random.default_rng(1).integers(0, 256, (side, side, 3), np.uint8), "jpeg")
    assert (len(data) > LIMITS.max_bytes) == (side == 2600)
    with pytest.raises(BodyTooLarge if side == 2600 else BadImage):
        pool.decode(data)

    for decoder in (pool, InProcessDecoder(LIMITS)):
        for patient in (False, True):
            assert decoder.decode(data, patient=patient, stored=True).pixels.shape == (side, side, 3)
        assert decoder.thumbnail(data, 64) == thumbnail(data, 64)
        with pytest.raises(BadImage, match="damaged"):
            decoder.decode(data[:-5000], stored=True)
    assert [process.starts for process in pool.processes] == [1, 1], "theirs is the memory of what is sent"


@pytest.mark.skipif(sys.platform != "linux", reason="threads have a priority of their own on Linux")
def test_a_decoder_that_an_import_had_to_start_again_serves_queries_as_before(pool: DecoderPool) -> None:
    def imports() -> None:
        step_aside()
        pool.decode(photo(), patient=True)

    pool.decode(photo())
    for process in pool.processes:
        os.kill(pid_of(process), signal.SIGKILL)
    importing = threading.Thread(target=imports)
    importing.start()
    importing.join()

    (again,) = (process for process in pool.processes if process.starts == 2)
    assert os.getpriority(os.PRIO_PROCESS, pid_of(again)) == os.getpriority(os.PRIO_PROCESS, 0)


@pytest.mark.parametrize("form", ["jpeg", "png", "webp", "bmp", "tiff"])
def test_an_image_is_the_same_decoded_apart(pool: DecoderPool, form: str) -> None:
    data = encoded(drawn(320, 240), form)
    here, apart = decode(data, LIMITS), pool.decode(data)
    assert np.array_equal(here.pixels, apart.pixels)
    assert (here.digest, here.format, here.byte_count) == (apart.digest, apart.format, apart.byte_count)
    assert pool.thumbnail(data, 64) == thumbnail(data, 64)


def test_the_smallest_limits_refuse_images_and_end_no_decoder() -> None:
    tiny = DecoderPool(1, Limits(max_bytes=2_000, max_pixels=1_100), deadline_s=20)
    tiny.start()
    try:
        with pytest.raises(BadImage, match=r"at most 0\.0011"):
            tiny.decode(encoded(np.zeros((35, 40, 3), np.uint8), "png"))
        assert tiny.decode(encoded(np.zeros((32, 32, 3), np.uint8), "png")).pixels.shape == (32, 32, 3)
        assert [process.starts for process in tiny.processes] == [1]
    finally:
        tiny.close()


def test_what_exif_says_is_the_same_apart(pool: DecoderPool) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "S", 2: (27.0, 24.0, 0.0), 3: "E", 4: (153.0, 0.0, 30.0), 16: "T", 17: 361.0})
    exif.get_ifd(0x8825).update({29: "2026:05:04", 7: (9.0, 30.0, 0.0)})
    said = encoded(drawn(320, 240), "jpeg", exif=exif)

    assert (
        pool.read_exif(said)
        == read_exif(io.BytesIO(said))
        == {
            "lat": pytest.approx(-27.4),
            "lon": pytest.approx(153 + 30 / 3600),
            "heading": 1,
            "captured_at": datetime(2026, 5, 4, 9, 30, tzinfo=UTC),
        }
    )
    for silent in (encoded(drawn(320, 240), "png"), b"", b"%PDF-1.7"):
        assert pool.read_exif(silent) == {}


@pytest.mark.parametrize(("latitude", "longitude"), [((95.0, 0.0, 0.0), (14.0, 0.0, 0.0)), ((0.0, 0.0, 0.0),) * 2])
def test_a_position_that_is_none_is_left_out(latitude: tuple[float, ...], longitude: tuple[float, ...]) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "N", 2: latitude, 3: "E", 4: longitude})

    assert read_exif(io.BytesIO(encoded(drawn(64, 48), "jpeg", exif=exif))) == {}


def test_refusals_are_the_same_apart(pool: DecoderPool) -> None:
    sound = encoded(drawn(320, 240), "png")
    for data in (b"", b"%PDF-1.7", sound[:2000], encoded(drawn(20, 20), "png"), encoded(drawn(1200, 900), "jpeg")):
        with pytest.raises(BadImage) as here:
            decode(data, LIMITS)
        with pytest.raises(BadImage) as apart:
            pool.decode(data)
        assert (here.value.code, here.value.detail) == (apart.value.code, apart.value.detail)
    with pytest.raises(BodyTooLarge):
        pool.decode(bytes(LIMITS.max_bytes + 1))


def test_many_threads_each_get_their_own_image(pool: DecoderPool) -> None:
    images = [encoded(drawn(160, 120, seed), "png") for seed in range(40)]
    with ThreadPoolExecutor(8) as threads:
        for data, image in zip(images, threads.map(pool.decode, images), strict=True):
            assert np.array_equal(image.pixels, decode(data, LIMITS).pixels)


def test_an_image_whose_decoder_is_killed_is_decoded_in_another(pool: DecoderPool) -> None:
    for _ in range(3):
        pool.decode(photo())
        for process in pool.processes:
            os.kill(pid_of(process), signal.SIGKILL)
        assert pool.decode(photo()).width == 64


def test_an_image_that_ends_its_decoder_twice_is_refused_and_neighbours_go_on() -> None:
    pool = DecoderPool(2, LIMITS, deadline_s=20)
    pool.start()
    data = encoded(drawn(320, 240), "png")
    stop = threading.Event()
    decoded: list[int] = []

    def neighbour() -> None:
        while not stop.is_set():
            decoded.append(pool.decode(data).width)

    ask = DecoderProcess.ask

    def crash(self: DecoderProcess, kind: int, given: bytes, longest: int = 0) -> object:
        if given == b"crash":
            ask(self, kind, photo())  # the process is ready
            pid = pid_of(self)
            os.kill(pid, signal.SIGSTOP)  # so that it neither answers nor is dead when it is asked
            threading.Timer(0.2, os.kill, (pid, signal.SIGSEGV)).start()
            threading.Timer(0.3, os.kill, (pid, signal.SIGCONT)).start()
        return ask(self, kind, given, longest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process_module.DecoderProcess, "ask", crash)
        thread = threading.Thread(target=neighbour)
        thread.start()
        try:
            for _ in range(3):
                with pytest.raises(BadImage) as caught:
                    pool.decode(b"crash")
                assert caught.value.code == "undecodable-picture"
        finally:
            stop.set()
            thread.join()
    assert set(decoded) == {320}
    pool.close()


def test_an_image_that_hangs_its_decoder_is_refused_at_the_deadline() -> None:
    pool = DecoderPool(1, LIMITS, deadline_s=1)
    pool.decode(photo())
    os.kill(pid_of(pool.processes[0]), signal.SIGSTOP)
    began = time.monotonic()
    with pytest.raises(BadImage) as caught:
        pool.decode(photo())
    assert "within 1 s" in caught.value.detail
    assert time.monotonic() - began < 10
    assert pool.decode(photo()).width == 64
    pool.close()


def test_more_images_than_decoders_wait_and_then_are_told_to_come_back() -> None:
    pool = DecoderPool(1, LIMITS, deadline_s=3)
    pool.decode(photo())
    process = pool._free.get()
    with pytest.raises(Busy) as caught:
        pool.decode(photo())
    assert caught.value.code == "too-many-requests"
    with ThreadPoolExecutor(1) as threads:
        patient = threads.submit(pool.decode, photo(), patient=True)
        pool._free.put(process)
        assert patient.result().width == 64
    pool.close()
    with pytest.raises(Unavailable):
        pool.decode(photo())


def test_a_check_starts_what_has_ended_and_says_why_nothing_can_be_started(
    pool: DecoderPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert pool.check() == "ok"
    for process in pool.processes:
        process.kill()
    assert pool.check() == "ok"

    def refuse(*_: object, **__: object) -> None:
        raise BlockingIOError(11, "Resource temporarily unavailable")

    for process in pool.processes:
        process.kill()
    monkeypatch.setattr(process_module, "launched", refuse)
    told = pool.check()
    assert "no process for decoding can be started" in told
    assert "raise the limit of processes (--pids-limit" in told
    with pytest.raises(Unavailable):
        pool.decode(photo())
    monkeypatch.undo()
    assert pool.check() == "ok"
    assert pool.decode(photo()).pixels.size


def test_decoders_end_with_a_service_that_is_killed() -> None:
    program = (
        "import sys, time\n"
        "from tests.images.test_decoding_apart import LIMITS, DecoderPool, photo\n"
        "pool = DecoderPool(2, LIMITS, 20); pool.start(); pool.decode(photo())\n"
        "print(*(process.pid for process in pool.processes), flush=True); time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        children = [int(word) for word in parent.stdout.readline().split()]
        assert len(children) == 2
        parent.kill()
    until(lambda: not any(map(alive, children)))


def alive(pid: int) -> bool:
    told = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False).stdout
    return bool(told.strip()) and not told.startswith("Z")


def test_a_decoder_loads_little() -> None:
    program = "import worker.images.apart.child, sys; print(*{name.partition('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    heavy = {"torch", "onnxruntime", "faiss", "sqlalchemy", "pydantic", "fastapi"}
    assert set(loaded.stdout.split()).isdisjoint(heavy)
