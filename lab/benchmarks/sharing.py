"""``./revisit benchmark sharing``: what a shared encoder costs a query, and how much is described through one.

Processes of their own with the built-in encoder, one thread for each network. Queries go in turns to a service with a
network in the process and to one that shares, so that whatever else the machine does meets both. Then two services with
networks of their own, and two that share one, each describe the same images; in turns too. At last one client sends
batches of eight to the shared encoder, as one call and as two that are under way together, in turns.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import cv2
import httpx
import numpy as np

from lab.faults.process import Running, client, settings
from scenes.scene import scene
from schemas.image import Image
from worker.encoders.compact.shared import SharedCompactEncoder

JPEG = {"content-type": "image/jpeg"}
OWN, SHARED = "own", "shared"


def drawn(number: int) -> bytes:
    """A JPEG of 640 x 480 of a drawn street."""
    _, data = cv2.imencode(".jpg", scene(f"street {number}").pixels[:, :, ::-1])
    return bytes(data)


@contextmanager
def running(command: str, data: Path, url: str | None, batch: int = 0) -> Iterator[httpx.Client]:
    """A process with the encoder compact, and calls of it."""
    further = {"REVISIT_ENCODER": "compact", "REVISIT_BATCH": str(batch)}
    if url is not None:
        further["REVISIT_ENCODER_URL"] = url
    with Running(command, settings(data, further)) as process:
        process.await_ready()
        with client(process.url) as calls:
            yield calls


def queries(clients: dict[str, httpx.Client], images: Sequence[bytes], repeats: int) -> dict[str, list[list[float]]]:
    """Milliseconds of each query, as its caller sees it and of its stage ``encode``, in turns."""
    took: dict[str, list[list[float]]] = {name: [] for name in clients}
    for turn in range(repeats + 3):  # the first three warm both
        for name in sorted(clients, reverse=bool(turn % 2)):
            began = time.perf_counter()
            answer = clients[name].post("/query", content=images[turn % len(images)], headers=JPEG).raise_for_status()
            if turn >= 3:
                whole = 1000 * (time.perf_counter() - began)
                took[name].append([whole, answer.json()["timing_ms"]["encode"]])
    return took


def images_a_second(services: Sequence[httpx.Client], images: Sequence[bytes], into: str) -> float:
    """How many images some services, each given all of them, describe together in a second."""

    def fill(calls: httpx.Client) -> None:
        for one in images:
            params = {"map": into, "wait": "false"}
            calls.post("/enroll", params=params, content=one, headers=JPEG).raise_for_status()
        while calls.get(f"/maps/{into}").raise_for_status().json()["views"].get("pending", 0):
            time.sleep(0.02)

    began = time.perf_counter()
    with ThreadPoolExecutor(len(services)) as threads:
        list(threads.map(fill, services))
    return len(services) * len(images) / (time.perf_counter() - began)


def batches(url: str, images: Sequence[bytes], repeats: int) -> dict[int, list[float]]:
    """Milliseconds until all fields of eight images are there, by the number of calls that are under way, in turns."""
    decoded = [decode(one) for one in images[:8]]
    with ExitStack() as held:
        encoders = {}
        for calls in (1, 2):
            encoders[calls] = SharedCompactEncoder(url, None, 10.0, in_flight=calls)
            held.callback(encoders[calls].close)
        took: dict[int, list[float]] = {calls: [] for calls in encoders}
        for turn in range(repeats + 2):  # the first two warm both
            for calls in sorted(encoders, reverse=bool(turn % 2)):
                began = time.perf_counter()
                for _ in encoders[calls].encode(decoded):
                    pass
                if turn >= 2:
                    took[calls].append(1000 * (time.perf_counter() - began))
    return took


def decode(data: bytes) -> Image:
    """A JPEG as an image."""
    return Image.of(np.ascontiguousarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="revisit benchmark sharing", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--repeats", type=int, default=60, help="queries of each kind (default: 60)")
    parser.add_argument("--images", type=int, default=24, help="images that each service describes (default: 24)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of describing (default: 3)")
    given = parser.parse_args(arguments)
    images = [drawn(number) for number in range(given.images)]
    with ExitStack() as held, tempfile.TemporaryDirectory(prefix="revisit-sharing-") as folder:
        data = Path(folder)
        url = str(held.enter_context(running("encode", data / "encoder", None, 8)).base_url)
        own, shared = (
            [held.enter_context(running("serve", data / f"{kind}-{n}", at)) for n in range(2)]
            for kind, at in ((OWN, None), (SHARED, url))
        )
        pair = {OWN: own[0], SHARED: shared[0]}
        for calls in pair.values():
            for one in images[:8]:
                calls.post("/enroll", content=one, headers=JPEG).raise_for_status()
        took = queries(pair, images, given.repeats)
        print(f"{'query, medians in ms':24}{OWN:>10}{SHARED:>10}{'ratio':>8}")
        for column, name in enumerate(("as the caller sees it", "its stage encode")):
            first, second = (statistics.median(one[column] for one in took[kind]) for kind in (OWN, SHARED))
            print(f"{name:24}{first:10.1f}{second:10.1f}{second / first:8.2f}")
        rates: dict[str, list[float]] = {OWN: [], SHARED: []}
        for turn in range(given.rounds):
            for kind, services in ((OWN, own), (SHARED, shared)):
                rates[kind].append(images_a_second(services, images, f"round-{turn}"))
        alone, both = (statistics.median(each) for each in batches(url, images, given.repeats).values())
        print(f"eight images, medians in ms: one call {alone:.1f}, two under way {both:.1f}, ratio {both / alone:.2f}")
        print(f"{'images a second, two services':32}" + ", ".join(
            f"{kind} {statistics.median(each):.1f} ({min(each):.1f} to {max(each):.1f})" for kind, each in rates.items()
        ))  # fmt: skip
