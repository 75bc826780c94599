"""``./revisit benchmark importing``: how fast recordings are imported, against the encoder's own rate in the same run.

A service of its own with the built-in encoder is sent the same drawn images as a zip archive, as a folder and as a
video, into a new map each, from the first byte sent until the last view is described. Before and after each the
encoder alone encodes them in this process, with as many threads and nothing else to do; a ratio is to the mean of these
two, so that whatever else the machine does meets both.
"""

import argparse
import statistics
import tempfile
import time
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lab.faults.process import Running, settings
from scenes.scene import scene
from schemas.image import Image
from schemas.settings import Settings
from worker.configure import configure
from worker.encoders.choosing import batch_of, make_encoder

if TYPE_CHECKING:
    from revisit_client import Revisit

KINDS = ("zip", "folder", "video")
PER_SECOND = 1.0
"""Frames a second of the video, all of which are enrolled."""


def recordings(folder: Path, count: int) -> dict[str, Path]:
    """The same images as a zip archive, a folder of JPEGs and a video of one frame a second."""
    images = folder / "walk"
    images.mkdir()
    video = folder / "walk.mp4"
    writer = None
    with zipfile.ZipFile(folder / "walk.zip", "w") as archive:
        for number in range(count):
            pixels = np.ascontiguousarray(scene(f"street {number}").pixels[:, :, ::-1])
            if writer is None:
                size = pixels.shape[1], pixels.shape[0]
                writer = cv2.VideoWriter(str(video), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"mp4v"), PER_SECOND, size)
            writer.write(pixels)
            file = images / f"{number:04}.jpg"
            cv2.imwrite(str(file), pixels)
            archive.write(file, file.name)
    if writer is not None:
        writer.release()
    return {"zip": folder / "walk.zip", "folder": images, "video": video}


def encoder_alone(threads: int, folder: Path) -> Callable[[], float]:
    """A function that encodes all images of a folder, batched as the service does, and says how many a second."""
    chosen = Settings(encoder="compact", threads=threads)
    configure(threads)
    encoder, _ = make_encoder(chosen, threads)
    images = [Image.of(np.asarray(cv2.imread(str(file), cv2.IMREAD_COLOR_RGB), np.uint8)) for file in _files(folder)]
    batch = batch_of(chosen)
    list(encoder.encode(images[:batch]))

    def rate() -> float:
        began = time.perf_counter()
        for start in range(0, len(images), batch):
            for _ in encoder.encode(images[start : start + batch]):
                pass
        return len(images) / (time.perf_counter() - began)

    return rate


def _files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.jpg"))


def imported(revisit: "Revisit", recording: Path, into: str, count: int) -> float:
    """Import a recording into a new map; returns how many images a second.

    Raises
    ------
    SystemExit
        Not all images became views.
    """
    began = time.perf_counter()
    job = revisit.import_recording(recording, map=into)
    done = revisit.wait_for_job(job.id, timeout=600)
    took = time.perf_counter() - began
    views = revisit.map(into).views["ready"]
    if done.state != "done" or views != count:
        raise SystemExit(f"{recording.name}: {views} of {count} images are views; {done.state}: {done.result}")
    return count / took


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="revisit benchmark importing", description=(__doc__ or "").partition("\n\n")[2]
    )
    parser.add_argument("--images", type=int, default=96, help="images of each recording (default: 96)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds (default: 3)")
    parser.add_argument("--threads", type=int, default=1, help="threads of the network (default: 1)")
    given = parser.parse_args(arguments)

    from revisit_client import Revisit

    own: list[float] = []
    rates: dict[str, list[float]] = {kind: [] for kind in KINDS}
    shares: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        paths = recordings(folder, given.images)
        alone = encoder_alone(given.threads, paths["folder"])
        further = {"REVISIT_ENCODER": "compact", "REVISIT_THREADS": str(given.threads)}
        with Running("serve", settings(folder / "data", further)) as process:
            process.await_ready()
            with Revisit(process.url, timeout=120) as revisit:
                imported(revisit, paths["folder"], "warm", given.images)
                own.append(alone())
                for number in range(given.rounds):
                    for kind in KINDS:
                        rates[kind].append(imported(revisit, paths[kind], f"{kind}-{number}", given.images))
                        own.append(alone())
                        shares[kind].append(rates[kind][-1] / statistics.mean(own[-2:]))
    print(f"{given.images} images of 640 x 480, {given.threads} threads of the network, {given.rounds} rounds\n")
    print("| | images a second | of the encoder's own rate, median (least to most) |\n|---|---|---|")
    print(f"| encoder | {statistics.median(own):.1f} | 1.00 |")
    for kind in KINDS:
        share = f"{statistics.median(shares[kind]):.2f} ({min(shares[kind]):.2f} to {max(shares[kind]):.2f})"
        print(f"| {kind} | {statistics.median(rates[kind]):.1f} | {share} |")
    print(
        f"\nencoder: {1000 / statistics.median(own):.1f} ms an image; all: " + ", ".join(f"{rate:.1f}" for rate in own)
    )


if __name__ == "__main__":
    main()
