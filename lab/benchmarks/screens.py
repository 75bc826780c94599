"""The console's picture for the README: ``python -m lab.benchmarks.screens --to docs``.

Starts the service on an empty folder, enrols drawn places over HTTP, asks in the console with another drawing of one,
and writes ``console.jpg``: a laptop in light and a phone in dark colours. Needs chromium and Playwright (a development
dependency), which downloads nothing.
"""

import argparse
import io
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from PIL import Image as PilImage

from lab.faults.process import client, serve
from scenes.scene import Scene, scene

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ViewportSize

PLACES = {
    "market street": (0, 0),
    "mill lane": (34, 8),
    "station road": (70, 2),
    "church street": (96, -22),
    "rose garden": (62, -48),
    "castle park": (18, -40),
    "river meadow": (-30, -52),
    "bakers row": (-42, 12),
}
"""Enrolled places and their positions, metres."""

QUERY = scene("mill lane").seen_from(dx=0.4, turn=-3).behind("bus")

LAPTOP: "ViewportSize" = {"width": 1180, "height": 960}
PHONE: "ViewportSize" = {"width": 390, "height": 960}
GAP_PX = 24


@contextmanager
def chromium() -> Iterator["Browser | None"]:
    """The machine's own Chromium, without a window; None where there is none."""
    from playwright.sync_api import sync_playwright

    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if found is None:
        yield None
        return
    with sync_playwright() as playwright:
        # A sandbox needs another user than root.
        arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = playwright.chromium.launch(executable_path=found, args=arguments)
        yield browser
        browser.close()


def encoded(look: Scene) -> bytes:
    """A drawing as JPEG."""
    out = io.BytesIO()
    PilImage.fromarray(look.pixels).save(out, "JPEG", quality=92)
    return out.getvalue()


def _enrol(url: str) -> None:
    with client(url) as http:
        for name, (x, y) in PLACES.items():
            for number, look in enumerate((scene(name), scene(name).at("overcast").seen_from(dx=-0.6, turn=-4))):
                fields = {"map": "town", "place": name, "x": str(x + 3 * number), "y": str(y), "wait": "true"}
                http.post("/enroll", files={"image": (f"{number}.jpg", encoded(look))}, data=fields).raise_for_status()


def _screen(
    browser: "Browser", url: str, photo: Path, size: "ViewportSize", theme: str, scrolled: int
) -> PilImage.Image:
    """The answer to a photo, in a window of a size, scrolled down by some pixels."""
    page = browser.new_page(viewport=size, color_scheme="dark" if theme == "dark" else "light")
    page.goto(url)
    page.get_by_label("Map", exact=True).select_option("town")
    page.get_by_label("Choose a photo").set_input_files(photo)
    page.wait_for_selector(".verdict")
    page.evaluate(f"scrollTo(0, {scrolled})")
    page.wait_for_timeout(1500)  # what is in sight now is fetched
    return PilImage.open(io.BytesIO(page.screenshot())).convert("RGB")


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the picture."""
    parser = argparse.ArgumentParser(description="the console's picture for the README")
    parser.add_argument("--to", type=Path, default=Path("docs"))
    options = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory() as folder,
        serve(Path(folder) / "data", {"REVISIT_ENCODER": "compact"}) as running,
        chromium() as browser,
    ):
        if browser is None:
            parser.exit(1, "chromium is not installed (Debian: apt-get install chromium)\n")
        _enrol(running.url)
        photo = Path(folder) / "today.jpg"
        photo.write_bytes(encoded(QUERY))
        laptop = _screen(browser, running.url, photo, LAPTOP, "light", 0)
        phone = _screen(browser, running.url, photo, PHONE, "dark", 520)
    both = PilImage.new("RGB", (laptop.width + GAP_PX + phone.width, laptop.height), "white")
    both.paste(laptop, (0, 0))
    both.paste(phone, (laptop.width + GAP_PX, 0))
    path = options.to / "console.jpg"
    both.save(path, quality=84, optimize=True)
    print(f"{path}: {both.width} x {both.height}, {path.stat().st_size / 1000:.0f} KB")


if __name__ == "__main__":
    main()
