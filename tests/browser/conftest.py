"""A browser on a running service: Debian's Chromium, driven by Playwright; nothing is downloaded."""

import json
import re
import shutil
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from lab.benchmarks import screens
from scenes import scene
from tests.stories.photos import jpeg
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page, Request, ViewportSize

PLACES = {"mill lane": (0, 0), "station road": (40, 5), "rose garden": (80, -12), "castle park": (31, 60)}
"""Names, and positions in metres."""

SETTINGS = {"REVISIT_ENCODER": "compact", "REVISIT_COMPARE": "false"}
"""Of the services that have the map of these places."""

PHONE: "ViewportSize" = {"width": 375, "height": 740}
LAPTOP: "ViewportSize" = {"width": 1280, "height": 800}

PATIENCE_MS = 60_000
"""How long a machine with much else to do may take to show something."""

SKIPPED = "NOT RUN: THE CONSOLE IS NOT TRIED IN A BROWSER"

REMEMBER = """(selector) => {
    const texts = new Set(JSON.parse(sessionStorage.getItem("remembered") ?? "[]"));
    new MutationObserver(() => {
        for (const one of document.querySelectorAll(selector)) texts.add(one.textContent);
        sessionStorage.setItem("remembered", JSON.stringify([...texts]));
    }).observe(document, { childList: true, subtree: true, characterData: true });
}"""

Open = Callable[..., "Tab"]


class Tab:
    """A page of the console; `close` fails when the browser had anything to complain of.

    Parameters
    ----------
    page : playwright.sync_api.Page
    url : str
        Of the service.
    refusals : bool
        Whether refused requests are expected, which browsers write into their console.
    """

    def __init__(self, page: "Page", url: str, refusals: bool) -> None:
        self.page, self.url, self._refusals = page, url, refusals
        self.complaints: list[str] = []
        self._fetched: set[Request] = set()  # images on their way
        page.on("console", lambda said: self._heard(said.type, f"{said.text} ({said.location['url']})"))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", self._sent)
        for ended in ("requestfinished", "requestfailed"):
            page.on(ended, lambda request: self._fetched.discard(request))
        page.on("response", lambda response: self._answered(response.url, response.status, response.request))

    def _heard(self, kind: str, text: str) -> None:
        refused = re.search(r"the server responded with a status of 4\d\d", text)
        changed = "net::ERR_NETWORK_CHANGED" in text  # an interface of the machine: the page has to come through it
        if kind in ("error", "warning") and not changed and not (refused and self._refusals):
            self.complaints.append(text)

    def _sent(self, request: "Request") -> None:
        if re.search(r"/(image|thumbnail|\w+\.png)(\?|$)", request.url):
            self._fetched.add(request)
        if not request.url.startswith((self.url, "blob:", "data:")):
            self.complaints.append(f"asked another host: {request.url}")

    def _answered(self, url: str, status: int, request: "Request") -> None:
        """The browser's own complaint of a failure says neither of what nor why."""
        if status >= 500:
            try:
                response = request.response()
                why = "no answer" if response is None else response.text()
            except Exception as error:  # the page may be gone
                why = str(error)
            self.complaints.append(f"{request.method} {url}: {status} {why}")

    def show(self, screen: str) -> None:
        """Go to a screen by its address."""
        self.page.goto(f"{self.url}/#{screen}")
        self.page.locator(f'main[data-screen="{screen}"], #sign-in').first.wait_for()

    def awaits(self, selector: str, count: int) -> None:
        """Wait until so many elements are there."""
        _expected(self.page.locator(selector)).to_have_count(count, timeout=PATIENCE_MS)

    def awaits_enabled(self, button: str) -> None:
        """Wait until a button can be pressed: it cannot while what it began is not over."""
        _expected(self.page.get_by_role("button", name=button)).to_be_enabled(timeout=PATIENCE_MS)

    def confirm(self, name: str) -> None:
        """Press the button that removes something, once no image is on its way: of what is gone there is none."""
        button = self.page.get_by_role("button", name=name, exact=True)
        button.scroll_into_view_if_needed()
        until = time.monotonic() + PATIENCE_MS / 1000
        while self._fetched:
            assert time.monotonic() < until, f"never arrived: {[request.url for request in self._fetched]}"
            self.page.wait_for_timeout(50)
        button.press("Enter")

    def remember(self, selector: str) -> None:
        """Keep from now on, across reloads, the texts of elements that may be shown for a moment only."""
        self.page.add_init_script(f"({REMEMBER})({json.dumps(selector)})")
        self.page.evaluate(REMEMBER, selector)

    def remembered(self) -> list[str]:
        """The texts that were kept, as they came."""
        texts: list[str] = json.loads(self.page.evaluate("sessionStorage.getItem('remembered') ?? '[]'"))
        return texts

    def is_wider_than_the_window(self) -> bool:
        """Whether one has to scroll sideways."""
        wide: bool = self.page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth")
        return wide

    def shows_its_images(self) -> None:
        """Wait for the images of the page: what comes moves what is below, and what is left is complained of."""
        self.page.wait_for_function("() => [...document.images].every((image) => image.complete)")

    def close(self) -> None:
        """Close the page.

        It may be asking for something at this moment. A test's handler that fetches it would fail in the next call,
        and without that handler the service may know nothing of what is asked for.
        """
        if not self.page.is_closed():  # else a test has closed it
            self.page.evaluate("0")  # what was complained of before is heard of before
            heard = list(self.complaints)
            self.page.unroute_all(behavior="ignoreErrors")
            self.page.context.close()
            self.complaints = heard
        assert self.complaints == []


def _expected(of: "Locator") -> Any:
    """Playwright's assertions of an element, which wait; it is imported where there is a browser alone."""
    from playwright.sync_api import expect

    return expect(of)


@pytest.fixture(scope="module")
def chromium() -> Iterator["Browser"]:
    """The browser; of one module, since Playwright's event loop must not outlive it."""
    pytest.importorskip("playwright.sync_api", reason=f"{SKIPPED}; Playwright is not installed")
    with screens.chromium() as browser:
        if browser is None:
            pytest.skip(f"{SKIPPED}; install chromium (Debian: apt-get install chromium)")
        yield browser


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of a service that has stopped: the map `town` of four places, by the built-in encoder."""
    data = tmp_path_factory.mktemp("town") / "data"
    with RunningService(data, **SETTINGS) as running:
        for name, (x, y) in PLACES.items():
            for step in (0, 1):
                look = taken(name, 12 * step)
                fields = {"map": "town", "place": name, "x": str(x + step), "y": str(y)}
                httpx.post(f"{running.url}/enroll", files={"image": look}, data=fields, timeout=60).raise_for_status()
    return data


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, chromium: "Browser", town: Path) -> Iterator[RunningService]:
    """A service with the map `town`."""
    data = tmp_path_factory.mktemp("data")
    shutil.copytree(town, data, dirs_exist_ok=True)
    with RunningService(data, **SETTINGS) as running:
        yield running


@pytest.fixture
def opened(chromium: "Browser", request: pytest.FixtureRequest) -> Iterator[Open]:
    """Opens tabs, each in a profile of its own, and closes them."""
    tabs: list[Tab] = []

    def open_tab(
        screen: str = "ask", url: str = "", size: "ViewportSize" = LAPTOP, refusals: bool = False, **profile: Any
    ) -> Tab:
        page = chromium.new_context(viewport=size, **profile).new_page()
        page.set_default_timeout(PATIENCE_MS)
        tabs.append(Tab(page, url or request.getfixturevalue("service").url, refusals))
        tabs[-1].show(screen)
        return tabs[-1]

    yield open_tab
    for tab in tabs:
        tab.close()


@pytest.fixture
def query_photo(tmp_path: Path) -> Path:
    """Another photo of mill lane."""
    path = tmp_path / "today.jpg"
    path.write_bytes(taken("mill lane", 25))
    return path


_drawn = cache(lambda name: scene(name).pixels)


def taken(name: str, aside: int) -> bytes:
    """A photo of a drawn place, by a camera that is turned by some pixels."""
    pixels = _drawn(name)
    width = pixels.shape[1] - 40
    return jpeg(pixels[:, aside : aside + width])
