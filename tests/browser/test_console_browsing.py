"""Looking through a large map: what is in sight stays there while views are edited and others come."""

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from app.http.examples import MAP_HEALTH, VIEW
from tests.browser.conftest import PATIENCE_MS, PHONE, Open, Tab
from tests.browser.test_console import ask
from tests.sample_images import photo as drawn_photo

if TYPE_CHECKING:
    from playwright.sync_api import Route

JOB = {
    "id": "j1", "kind": "recipe", "state": "running", "map": "town", "view": None, "attempts": 1, "failure": None,
    "progress": {"done": 3, "total": 9}, "result": None, "created_at": "2026-03-01T12:00:00Z", "finished_at": None,
}  # fmt: skip


class MadeUp:
    """A map with so many views of each place, answered in the service's own shape.

    Parameters
    ----------
    tab : Tab
    places : int
        Views by the name of their place.
    """

    def __init__(self, tab: Tab, **places: int) -> None:
        self.rows: list[dict[str, Any]] = [
            VIEW
            | {"id": f"v{number:06}", "map": "town", "place": place, "links": _links(f"v{number:06}")}
            | {"position": VIEW["position"] | {"x": number % 200, "y": number // 200}}
            for number, place in enumerate(place for place, count in places.items() for _ in range(count))
        ]
        self.revision = 1
        self.read: list[str] = []  # what was fetched of the list
        self.jobs: list[dict[str, Any]] = []
        self._photo = drawn_photo(1)
        tab.page.route(re.compile(r"/views|/places|/maps/town$|/jobs"), self._answer)

    def add(self, place: str) -> None:
        """One more view at the end."""
        name = f"v{len(self.rows):06}"
        self.rows.append(self.rows[-1] | {"id": name, "place": place, "links": _links(name)})
        self.revision += 1

    def _answer(self, route: "Route") -> None:
        url = httpx.URL(route.request.url)
        if url.path == "/views":
            self.read.append(str(url.query, "ascii"))
            chosen = [row for row in self.rows if url.params.get("place") in (None, row["place"])]
            begin, limit = int(url.params.get("cursor", "0")), int(url.params["limit"])
            after = str(begin + limit) if begin + limit < len(chosen) else None
            route.fulfill(json={"views": chosen[begin : begin + limit], "next": after})
        elif url.path == "/places":
            names = sorted({row["place"] for row in self.rows})
            counted = [{"place": name, "views": sum(row["place"] == name for row in self.rows)} for name in names]
            route.fulfill(json={"places": counted, "next": None})
        elif url.path.startswith("/jobs"):
            kinds = url.params["kind"].split(",")
            route.fulfill(json={"jobs": [job for job in self.jobs if job["kind"] in kinds], "next": None})
        elif url.path == "/maps/town":
            facts = route.fetch().json()
            made = {"views": {"ready": len(self.rows)}, "places": 2, "revision": self.revision}
            route.fulfill(json=facts | made)
        elif route.request.method == "PATCH":
            [number] = [at for at, row in enumerate(self.rows) if url.path == f"/views/{row['id']}"]
            self.rows[number] = self.rows[number] | {"place": json.loads(route.request.post_data or "{}")["place"]}
            self.revision += 1
            route.fulfill(json=self.rows[number])
        elif url.path in (links := {row["links"]["self"]: row for row in self.rows}):
            route.fulfill(json=links[url.path])
        else:
            route.fulfill(body=self._photo, content_type="image/jpeg")


def _links(name: str) -> dict[str, str]:
    drawn = {kind: f"/views/{name}/{kind}" for kind in ("image", "thumbnail")}
    return {"self": f"/views/{name}", **drawn, "segmentation": f"/views/{name}/s.png", "graph": f"/views/{name}/g.png"}


def scrolled(tab: Tab, pixels: int | None = None) -> int:
    """How far the thumbnails are scrolled; to where they are scrolled first."""
    grid = tab.page.get_by_role("region", name="Thumbnails of views")
    if pixels is not None:
        grid.evaluate("(grid, pixels) => { grid.scrollTop = pixels }", pixels)
    top: int = grid.evaluate("grid => grid.scrollTop")
    return top


def rename(tab: Tab, button: str, place: str) -> None:
    tab.page.get_by_label(button, exact=True).press("Enter")
    tab.page.get_by_text("Edit", exact=True).press("Enter")
    tab.page.get_by_role("dialog").get_by_label("Place").fill(place)
    tab.page.get_by_role("dialog").get_by_label("Place").press("Enter")
    tab.page.get_by_role("dialog").wait_for(state="detached")


def test_an_edited_view_leaves_the_list_where_it_is(opened: Open) -> None:
    """The place that is chosen, what is in sight, the button with the focus, and what is unfolded below."""
    tab = opened("service", size=PHONE)
    MadeUp(tab, north=4, south=60)
    tab.show("maps/town")
    tab.page.get_by_text("Recipe and ranking").click()
    tab.page.get_by_role("button", name="south 60 views").click()
    tab.page.get_by_role("heading", name="south").wait_for()
    there = scrolled(tab, 1500)
    rename(tab, "View 30: south", "north")
    tab.page.get_by_role("button", name="south 59 views").wait_for()
    assert tab.page.get_by_role("button", name="south 59 views").get_attribute("aria-pressed") == "true"
    assert tab.page.get_by_role("heading", name="south").is_visible()
    assert scrolled(tab) == there
    tab.page.wait_for_function("document.activeElement.ariaLabel === 'View 30: south'")
    assert tab.page.locator("details", has_text="Recipe and ranking").get_attribute("open") is not None


def test_the_last_view_of_a_place_leads_back_to_all(opened: Open) -> None:
    tab = opened("service")
    MadeUp(tab, north=1, south=3)
    tab.show("maps/town")
    tab.page.get_by_role("button", name="north 1 view").click()
    tab.page.get_by_role("heading", name="north").wait_for()
    rename(tab, "View 1: north", "south")
    tab.page.get_by_role("heading", name="All views").wait_for()
    tab.awaits(".grid .cell", 4)


def test_views_that_come_leave_the_place_that_is_looked_at_and_what_is_typed(opened: Open) -> None:
    tab = opened("service", size=PHONE)
    town = MadeUp(tab, north=4, south=60)
    town.jobs = [JOB | {"kind": "import"}]
    tab.show("maps/town")
    tab.page.get_by_role("button", name="south 60 views").click()
    tab.page.get_by_label("View 1: south").wait_for()
    there = scrolled(tab, 1500)
    tab.page.get_by_label("Share of sure answers").fill("0.9")
    town.add("south")
    town.jobs = [JOB | {"kind": "import", "state": "done"}]
    tab.page.get_by_role("button", name="south 61 views").wait_for()
    assert scrolled(tab) == there
    assert tab.page.get_by_label("Share of sure answers").input_value() == "0.9"
    scrolled(tab, 10_000)
    tab.page.get_by_label("View 61: south").wait_for()


def test_all_views_of_a_place_are_there_however_many(opened: Open) -> None:
    tab = opened("service")
    MadeUp(tab, north=4, south=1200)
    tab.show("maps/town")
    tab.page.get_by_role("button", name="south 1,200 views").click()
    for _ in range(3):
        tab.page.wait_for_timeout(200)
        scrolled(tab, 100_000)
    tab.page.get_by_label("View 1200: south").wait_for()


def test_the_plan_of_a_very_large_map_is_read_on_when_somebody_wants_all(opened: Open) -> None:
    tab = opened("service")
    town = MadeUp(tab, north=10_000, south=11_200)
    tab.show("maps/town")
    # Forty pages are fetched, each of them made up by this process.
    tab.page.get_by_text("It shows the first 20,000 of 21,200 views.").wait_for(timeout=4 * PATIENCE_MS)
    tab.page.get_by_label("Plan with 20,000 positions").wait_for()
    tab.page.get_by_role("button", name="Show all").click()
    tab.page.get_by_label("Plan with 21,200 positions").wait_for()
    assert tab.page.get_by_text("It shows the first").count() == 0

    # What is added is read, and nothing else of the whole.
    town.read.clear()
    town.jobs = [JOB]
    tab.page.get_by_role("button", name="Train a vocabulary").click()
    tab.page.get_by_role("button", name="Cancel").wait_for()
    town.add("south")
    town.jobs = []
    tab.page.get_by_label("Plan with 21,201 positions").wait_for()
    assert len(town.read) == 2


def test_photos_are_placed_on_the_plan_of_the_whole_map(opened: Open) -> None:
    tab = opened("enrol")
    MadeUp(tab, north=500, south=700)
    tab.page.get_by_label("Map", exact=True).select_option("town")
    tab.page.get_by_text("Set positions on the plan").click()
    tab.page.get_by_label("Plan with 1,200 positions").wait_for()


def test_an_edited_view_leaves_as_many_findings_as_there_were(opened: Open) -> None:
    tab = opened("service")
    town = MadeUp(tab, north=30)
    duplicates = [
        MAP_HEALTH["findings"][0] | {"code": "duplicates", "detail": f"pair {number}", "views": [f"v{number:06}"]}
        for number in range(15)
    ]
    counts = {"duplicates": 15}
    health = MAP_HEALTH | {"counts": counts, "findings": duplicates}
    tab.page.route("**/maps/town/health*", lambda route: route.fulfill(json=health))
    tab.show("maps/town/health")
    tab.awaits(".finding", 6)
    tab.page.get_by_role("button", name="More").click()
    tab.awaits(".finding", 12)
    tab.page.locator(".finding", has_text="Pair 11").get_by_role("button", name="Open north").press("Enter")
    tab.page.get_by_text("Edit", exact=True).press("Enter")
    tab.page.get_by_role("dialog").get_by_label("Place").fill("south")
    tab.page.get_by_role("dialog").get_by_label("Place").press("Enter")
    tab.page.locator(".finding", has_text="Pair 11").get_by_role("button", name="Open south").wait_for()
    tab.awaits(".finding", 12)
    assert town.rows[11]["place"] == "south"


def test_what_backgrounds_say_is_seen_in_the_colours_of_the_system(opened: Open, query_photo: Path) -> None:
    """With high contrast bars were empty, no label had a colour, and nothing was the screen that is shown."""
    backgrounds = "found => found.map((one) => getComputedStyle(one).backgroundColor)"
    tab = opened(forced_colors="active")
    ask(tab, query_photo)
    page = tab.page.locator("body").evaluate("body => getComputedStyle(body).backgroundColor")
    for selector in (".bar > span", "nav a[aria-current]", "button[aria-pressed=true]"):
        assert page not in tab.page.locator(selector).evaluate_all(backgrounds), selector
    tab.show("maps/town")
    tab.page.locator(".swatch").first.wait_for()
    assert len(set(tab.page.locator(".swatch").evaluate_all(backgrounds))) > 5
