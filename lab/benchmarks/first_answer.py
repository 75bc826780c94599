"""A newcomer's first ten photos in the console, with the time of each step: ``python -m lab.benchmarks.first_answer``.

Starts the service on an empty folder, opens the console in Chromium, enrols ten photos with their places, and asks with
others until an answer is sure. ``--photos`` is a folder whose files are named after their places; ``--ask`` has other
photos of them. Without them all are drawn. Needs chromium and Playwright (a development dependency); nothing is
downloaded.
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lab.benchmarks.screens import PLACES, chromium, encoded
from lab.faults.process import serve
from scenes.scene import scene

if TYPE_CHECKING:
    from playwright.sync_api import Browser

TEN = 10
MORE_PLACES = ("harbour road", "school lane")
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".heic")
LIMIT_MS = 60_000


@dataclass(frozen=True)
class Step:
    """A step of the path.

    Parameters
    ----------
    name : str
    seconds : float
        From the click to what is seen then.
    seen : str
    """

    name: str
    seconds: float
    seen: str = ""


def walk(browser: "Browser", url: str, photos: Sequence[Path], queries: Sequence[Path]) -> Iterator[Step]:
    """Enrol photos in a new map by the console, each with its file's name as its place, and ask until one is sure."""
    page = browser.new_page()
    page.set_default_timeout(LIMIT_MS)
    began = time.perf_counter()
    page.goto(url)
    page.locator("main[data-screen]").first.wait_for()
    yield Step("the console opens", time.perf_counter() - began)
    page.get_by_role("link", name="Enrol").click()
    page.get_by_label("or a new map").fill("mine")
    page.get_by_label("Choose photos").set_input_files(photos)
    for photo in photos:
        page.get_by_label(f"Place of {photo.name}").fill(photo.stem)
    began = time.perf_counter()
    page.get_by_role("button", name=f"Enrol {len(photos)} photos").click()
    page.locator("main").get_by_text(f"{len(photos)} of {len(photos)} photos done").wait_for()
    yield Step(f"{len(photos)} photos are enrolled", time.perf_counter() - began)
    page.get_by_role("link", name="Ask").click()
    page.get_by_label("Map", exact=True).select_option("mine")
    for query in queries:
        began = time.perf_counter()
        with page.expect_response(lambda response: "/query" in response.url):
            page.get_by_label("Choose a photo").set_input_files(query)
        page.locator(".verdict h2").wait_for()
        seen = page.locator(".verdict h2").inner_text()
        yield Step(query.name, time.perf_counter() - began, seen)
        if seen.startswith("This is"):
            return


def drawn(folder: Path) -> tuple[list[Path], list[Path]]:
    """Ten places as files named after them, and others of the same places: a step aside, at dusk."""
    both: tuple[list[Path], list[Path]] = [], []
    for number, name in enumerate((*PLACES, *MORE_PLACES)):
        looks = scene(name), scene(name).at("dusk").seen_from(dx=0.5, turn=3)
        for kind, look, found in zip(("enrolled", "asked"), looks, both, strict=True):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            path = folder / kind / (f"{name}.jpg" if kind == "enrolled" else f"{number}.jpg")
            path.write_bytes(encoded(look))
            found.append(path)
    return both


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the steps; 1 when no answer was sure."""
    parser = argparse.ArgumentParser(
        prog="python -m lab.benchmarks.first_answer", description="a newcomer's first ten photos, timed"
    )
    parser.add_argument("--photos", type=Path, help="a folder; the first ten are enrolled, their names are the places")
    parser.add_argument("--ask", type=Path, help="a folder with other photos of the same places")
    options = parser.parse_args(arguments)
    if (options.photos is None) != (options.ask is None):
        parser.error("--photos and --ask go together")
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        if browser is None:
            parser.exit(1, "chromium is not installed (Debian: apt-get install chromium)\n")
        photos, queries = drawn(Path(folder)) if options.ask is None else (_in(options.photos), _in(options.ask))
        began = time.perf_counter()
        with serve(Path(folder) / "data", {"REVISIT_ENCODER": "compact"}, warm=False) as running:
            print(f"{time.perf_counter() - began:6.1f} s  the service is ready")
            step = None
            for step in walk(browser, running.url, photos[:TEN], queries):
                print(f"{step.seconds:6.1f} s  {step.name}{step.seen and f': {step.seen}'}", flush=True)
    return 0 if step is not None and step.seen.startswith("This is") else 1


def _in(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)


if __name__ == "__main__":
    raise SystemExit(main())
