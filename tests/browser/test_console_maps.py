"""What the console shows of one map besides its views: its health, its inbox; and snapshots."""

import re
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from app.http.examples import MAP_HEALTH, VIEW
from scenes import scene
from tests.browser.conftest import LAPTOP, PHONE, Open, Tab
from tests.sample_images import photo
from tests.stories.photos import jpeg
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Route

AXE = "axe.run().then((found) => found.violations.flatMap((one) => one.nodes.map((node) => `${one.id}: ${node.html}`)))"


def enrolled(service: RunningService, map_name: str, image: bytes, **fields: str) -> None:
    data = {"map": map_name, **fields}
    httpx.post(f"{service.url}/enroll", files={"image": image}, data=data, timeout=60).raise_for_status()


def seen(place: str, quality: int = 90) -> bytes:
    """A photo of a drawn place."""
    return jpeg(scene(place).pixels, quality)


def check(tab: Tab, name: str) -> None:
    """Nothing that axe finds, in both colours and on a phone."""
    for size, colours in ((LAPTOP, "light"), (PHONE, "dark")):
        tab.page.set_viewport_size(size)
        tab.page.emulate_media(color_scheme=colours)  # type: ignore[arg-type]
        tab.page.evaluate((resources.files("axe_playwright_python") / "axe.min.js").read_text())
        assert tab.page.evaluate(AXE) == [], f"{name}, {colours}"
        assert not tab.is_wider_than_the_window(), name
    tab.page.set_viewport_size(LAPTOP)


# health


@pytest.fixture(scope="module")
def site(service: RunningService) -> str:
    """A map with the same photo under two names, places without some directions, and a place seen once."""
    enrolled(service, "site", seen("mill lane"), place="hall", x="0", y="0", heading="0")
    enrolled(service, "site", seen("mill lane", 75), place="stairs", x="40", y="0", heading="0")
    enrolled(service, "site", seen("rose garden"), place="gate", x="90", y="0", heading="90")
    return "site"


def test_an_owner_sees_what_a_map_lacks_and_mends_it(opened: Open, service: RunningService, site: str) -> None:
    tab = opened(f"maps/{site}", bypass_csp=True)
    tab.page.get_by_role("link", name="Health").click()

    duplicates = tab.page.locator("[data-code=duplicates]")
    tab.awaits("[data-code=duplicates] .side img[src^=blob]", 2)
    assert "are enrolled as hall, stairs" in duplicates.inner_text().replace(" and ", ", ")
    assert "give all of them one place." in duplicates.inner_text()  # not by which call of the API
    directions = tab.page.locator("[data-code=missing-directions]")
    assert directions.get_by_text("Not towards").count() == 0
    tab.page.get_by_role("button", name="Missing directions: 3").press("Enter")
    directions.get_by_text("Not towards east, south, west: 2 places").press("Enter")
    directions.get_by_role("button", name="See hall").wait_for()
    check(tab, "health")

    duplicates.get_by_role("button", name="Open stairs").click()
    tab.page.get_by_role("button", name="Delete this view …").click()
    tab.confirm("Delete the view")
    tab.page.locator("dialog.receipt").get_by_role("button", name="Close").click()
    tab.page.get_by_text("Duplicates: 0").wait_for()
    assert {one["place"] for one in httpx.get(f"{service.url}/views?map=site").json()["views"]} == {"hall", "gate"}


def test_twins_are_side_by_side_and_many_directions_are_folded(opened: Open, service: RunningService) -> None:
    """The service's answers are made up here, in its own shape."""
    views = httpx.get(f"{service.url}/views?map=town").json()["views"]
    two = [next(one for one in views if one["place"] == name) for name in ("mill lane", "castle park")]
    twins = MAP_HEALTH["findings"][0] | {
        "code": "twins",
        "detail": "'mill lane' and 'castle park' look alike",
        "remedy": "enrol both where they differ",
        "places": ["mill lane", "castle park"],
        "views": [one["id"] for one in two],
    }
    limits: list[str] = []

    def answered(route: "Route") -> None:
        params = httpx.URL(route.request.url).params
        limits.append(params["limit"])
        one = MAP_HEALTH["findings"][0]
        sides: list[dict[str, Any]] = [
            one | {"places": [f"place {number}"], "headings": [180.0] if number % 3 else [90.0, 180.0]}
            for number in range(int(params["limit"]))
        ]
        counts = MAP_HEALTH["counts"] | {"twins": 1, "missing-directions": 3000}
        route.fulfill(json=MAP_HEALTH | {"compared": 12, "counts": counts, "findings": [twins, *sides]})

    tab = opened("service")
    tab.page.route("**/maps/town/health*", answered)
    tab.show("maps/town/health")
    tab.awaits("[data-code=twins] .side img[src^=blob]", 2)
    assert tab.page.locator("[data-code=twins] .side span").all_inner_texts()[0] == "mill lane"
    assert tab.page.get_by_text("12 so far; twins are found among these.").is_visible()
    assert limits == ["20"]

    tab.page.get_by_text("Missing directions: 3,000").last.click()
    tab.page.get_by_text("The first 501 of 3,000").wait_for()
    tab.page.get_by_text("Not towards south: 333 places").click()
    rows = "[data-code=missing-directions] tbody tr"
    tab.awaits(rows, 50)
    tab.page.get_by_role("button", name="All 333").click()
    tab.awaits(rows, 333)


def test_a_place_that_ages_is_shown_with_the_photo_that_would_refresh_it(opened: Open, service: RunningService) -> None:
    """Months of scores are made up here, in the service's own shape; so is the photo."""
    views = httpx.get(f"{service.url}/views?map=town&place=mill lane").json()["views"]
    ageing = MAP_HEALTH["findings"][0] | {
        "code": "ageing",
        "detail": "'mill lane' scores less than it did: 0.90 on the first 15 days, 0.61 on the last 15",
        "remedy": "take the photos that queries left of it",
        "places": ["mill lane"],
        "views": [one["id"] for one in views],
        "scores": {"then": 0.9, "now": 0.61, "since": "2026-03-02", "until": "2026-08-20", "days": 15},
        "proposal": "some-query",
    }
    health = {"counts": MAP_HEALTH["counts"] | {"ageing": 1, "missing-directions": 0}, "findings": [ageing]}
    tab = opened("service", bypass_csp=True)
    tab.page.route("**/maps/town/health*", lambda route: route.fulfill(json=MAP_HEALTH | health))
    photo = seen("mill lane", 30)
    tab.page.route("**/proposals/some-query/image", lambda route: route.fulfill(body=photo, content_type="image/jpeg"))
    tab.show("maps/town/health")
    tab.awaits("[data-code=ageing] .side img[src^=blob]", 2)
    tab.awaits("[data-code=ageing] .refreshing img[src^=blob]", 1)
    check(tab, "a place that ages")
    tab.page.get_by_role("link", name="Take or dismiss it").click()
    tab.page.get_by_role("heading", name="No place in another light").wait_for()


def test_health_of_an_empty_map_has_no_fact_without_a_value(opened: Open, service: RunningService) -> None:
    httpx.put(f"{service.url}/maps/empty").raise_for_status()
    tab = opened("maps/empty/health")
    tab.page.get_by_text("Views examined").wait_for()
    assert "" not in tab.page.locator("main dd").all_inner_texts()
    httpx.delete(f"{service.url}/maps/empty").raise_for_status()


def test_the_health_of_a_map_that_is_not_there_is_refused_in_words(opened: Open) -> None:
    tab = opened("maps/moon/health", refusals=True)
    assert "there is no map 'moon'" in tab.page.get_by_role("alert").inner_text()
    assert tab.page.locator("main").get_attribute("aria-busy") is None  # nothing more is to come
    assert VIEW["id"] not in tab.page.content()


# inbox


def test_a_spot_that_matched_nothing_is_named_and_known_from_then_on(opened: Open, service: RunningService) -> None:
    for place in ("mill lane", "rose garden", "castle park", "station road", "market street"):
        enrolled(service, "quay", seen(place), place=place)
    tab = opened("maps/quay", bypass_csp=True, refusals=True)
    tab.page.get_by_role("link", name="Inbox").click()
    tab.page.get_by_text("Off: queries that match nothing are not kept.").wait_for()
    tab.page.get_by_label("At most").press("Enter")
    tab.page.locator("main").get_by_text("Up to 500 queries that match nothing are kept.").wait_for()
    assert httpx.get(f"{service.url}/maps/quay").json()["keep_queries"] == 500

    for place, quality in (("river meadow", 90), ("river meadow", 80), ("bakers row", 90)):
        answer = httpx.post(
            f"{service.url}/query", data={"map": "quay"}, files={"image": seen(place, quality)}, timeout=60
        )
        assert answer.json()["status"] == "no_match"
    tab.page.reload()
    tab.page.get_by_role("heading", name="2 spots that this map does not know").wait_for()
    tab.awaits(".spot > img[src^=blob]", 2)
    tab.page.get_by_text("Its other photos").press("Enter")
    tab.awaits(".spot .sides img[src^=blob]", 1)
    check(tab, "inbox")

    twice = tab.page.locator(".spot", has_text="Seen 2 times")
    twice.get_by_label("What place is it?").fill("river meadow")
    twice.get_by_label("Position, if known").fill("4, far")
    twice.get_by_label("Position, if known").press("Enter")
    assert "position.y" in twice.get_by_role("alert").inner_text()
    twice.get_by_label("Position, if known").fill("4, 5, 90")
    twice.get_by_role("button", name="Name it").press("Enter")
    tab.page.locator("main").get_by_text("2 photos of river meadow enrolled.").wait_for()
    named = httpx.get(f"{service.url}/views?map=quay&place=river meadow").json()["views"]
    assert [(one["position"]["x"], one["position"]["heading"]) for one in named] == [(4, 90)] * 2

    tab.awaits(".spot", 1)
    tab.page.get_by_role("button", name="Dismiss …").click()
    tab.confirm("Dismiss")
    tab.page.get_by_role("heading", name="Nothing to name").wait_for()
    assert httpx.get(f"{service.url}/maps/quay/unknown").json()["kept"] == 0


def test_a_place_in_another_light_is_taken_as_a_view_of_it(opened: Open, service: RunningService) -> None:
    for place in ("mill lane", "rose garden", "castle park", "station road"):
        enrolled(service, "night", seen(place), place=place)
    tab = opened("maps/night/inbox", bypass_csp=True)
    tab.page.get_by_text("Off: queries that match in another light are not kept.").wait_for()
    tab.page.get_by_label("Number of matches").press("Enter")
    tab.page.locator("main").get_by_text("Up to 500 queries that match in another light are kept.").wait_for()

    for place, sideways in (("station road", 0.5), ("station road", 0.9), ("rose garden", 0.8)):
        image = jpeg(scene(place).at("night").seen_from(dx=sideways, turn=3).pixels)
        answer = httpx.post(f"{service.url}/query", data={"map": "night"}, files={"image": image}, timeout=60)
        assert answer.json()["status"] == "matched"
    tab.page.reload()
    tab.page.get_by_role("heading", name="2 places seen in another light").wait_for()
    tab.awaits(".proposal .sides img[src^=blob]", 4)
    check(tab, "proposals")

    tab.page.locator(".proposal", has_text="station road").get_by_role("button", name="Take").click()
    tab.page.locator("main").get_by_text("2 photos of station road taken.").wait_for()
    views = httpx.get(f"{service.url}/views?map=night&place=station road").json()["views"]
    assert [bool(view["metadata"]) for view in views] == [False, True, True]

    alone = tab.page.locator(".proposal", has_text="rose garden")
    alone.get_by_role("button", name="Take it …").click()
    tab.page.get_by_text("No other query matched this place").wait_for()
    tab.page.get_by_role("button", name="Cancel").click()
    alone.get_by_role("button", name="Dismiss proposal …").click()
    tab.confirm("Dismiss")
    tab.page.get_by_role("heading", name="No place in another light").wait_for()
    assert httpx.get(f"{service.url}/maps/night/proposals").json()["kept"] == 0


# recipe


def test_another_recipe_is_tried_in_the_shadow_and_switched_to(opened: Open, service: RunningService) -> None:
    for place in ("mill lane", "rose garden", "castle park"):
        enrolled(service, "shade", seen(place), place=place)
    httpx.patch(f"{service.url}/maps/shade", json={"keep_queries": 5, "ranking": {"candidates": 7}}, timeout=60)
    for place in ("river meadow", "harbour"):
        httpx.post(f"{service.url}/query", data={"map": "shade"}, files={"image": seen(place)}, timeout=60)
    tab = opened("maps/shade", bypass_csp=True)
    tab.page.get_by_role("link", name="Recipe").click()
    tab.page.get_by_label("Those that move").fill("car, tree")
    tab.page.get_by_label("Queries to compare").fill("5")
    tab.page.get_by_text("1 parameter differs from the preset").click()
    tab.page.get_by_role("row", name="ranking.candidates 7 50").wait_for()  # it is unfolded in a moment
    tab.page.get_by_label("Parameters and ranking as the preset has them now").check()
    check(tab, "a recipe")

    tab.page.get_by_role("button", name="Try it in the shadow").press("Enter")
    tab.page.get_by_role("heading", name="A shadow is ready").wait_for()
    totals = httpx.get(f"{service.url}/maps/shade/shadow").json()["table"]["totals"]
    told = tab.page.locator("main").inner_text()
    assert f"Of 5 queries, {totals['agree']} are answered alike" in told
    tab.awaits(".shadow-rows .match", 5 - totals["agree"])
    tab.page.get_by_role("region", name="Totals").get_by_text("Views described").wait_for()
    check(tab, "a shadow")
    assert httpx.get(f"{service.url}/maps/shade").json()["recipe"]["dynamic"] != ["car", "tree"]

    tab.page.get_by_role("button", name="Discard it …").click()
    tab.page.get_by_role("button", name="Cancel").click()
    tab.page.get_by_role("button", name="Change over to it").press("Enter")
    tab.page.locator("main").get_by_text("The map has changed over.").wait_for()
    now = httpx.get(f"{service.url}/maps/shade").json()
    assert (now["recipe"]["dynamic"], now["ranking"]["candidates"]) == (["car", "tree"], 50)
    tab.page.get_by_role("heading", name="Describe all views anew").wait_for()


# snapshots


def test_a_map_is_saved_to_a_file_and_restored_under_another_name(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    tab = opened("maps/town", bypass_csp=True, refusals=True)
    tab.page.get_by_role("link", name="Snapshots").click()
    tab.page.get_by_role("button", name="Make a snapshot").press("Enter")
    tab.page.locator("main").get_by_text("The snapshot of town is made.").wait_for()
    with tab.page.expect_download() as download:
        tab.page.get_by_label("Download the snapshot of town").click()
    file = tmp_path / "town.snapshot"
    download.value.save_as(file)
    check(tab, "snapshots")

    tab.page.get_by_label("Choose a snapshot file").set_input_files(file)
    tab.page.get_by_role("button", name="Restore").click()
    assert "town" in tab.page.get_by_role("alert").inner_text()
    (tmp_path / "bad.snapshot").write_bytes(file.read_bytes()[:-2000])
    tab.page.get_by_label("Choose a snapshot file").set_input_files(tmp_path / "bad.snapshot")
    tab.page.get_by_label("Under another name").fill("hamlet")
    tab.page.get_by_role("button", name="Restore").click()
    tab.page.get_by_text("the snapshot is refused, and nothing was changed").wait_for()
    assert httpx.get(f"{service.url}/maps/hamlet").status_code == 404
    tab.page.get_by_label("Choose a snapshot file").set_input_files(file)
    tab.page.get_by_role("button", name="Restore").click()
    tab.page.locator("main").get_by_text(re.compile("Restored as hamlet: 8 views")).wait_for()
    httpx.delete(f"{service.url}/maps/hamlet", timeout=60).raise_for_status()

    tab.page.get_by_label("Delete the snapshot of town").click()
    tab.confirm("Delete the snapshot")
    tab.page.get_by_text("None yet.").wait_for()
    assert httpx.get(f"{service.url}/snapshots").json() == {"snapshots": []}


# the plan and the labels


def test_the_shares_of_a_maps_labels_are_shown(opened: Open) -> None:
    tab = opened("maps/town")
    tab.page.get_by_text("How much of the views each label covers").click()
    rows = tab.page.locator("details", has_text="each label covers").locator(".bars li")
    rows.first.wait_for()
    shares = [float(text.split()[0]) for text in rows.locator(".number").all_inner_texts() if text[0].isdigit()]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 10


def test_a_plan_on_both_sides_of_the_date_line_is_as_narrow_as_its_map(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    for seed, lon in ((220, 179.9999), (221, -179.9999)):
        address = f"{service.url}/enroll?map=island&lat=-17&lon={lon}"
        assert httpx.post(address, content=photo(seed), timeout=60).status_code == 201
    extent = httpx.get(f"{service.url}/maps/island").json()["extent"]
    assert (extent["minimum"]["lon"], extent["maximum"]["lon"]) == (179.9999, -179.9999)
    (tmp_path / "beach.jpg").write_bytes(photo(222))
    tab = opened("enrol")
    tab.page.get_by_label("Map", exact=True).select_option("island")
    tab.page.get_by_label("Choose photos").set_input_files([tmp_path / "beach.jpg"])
    tab.page.get_by_text("Set positions on the plan").click()
    tab.page.locator("canvas.plan").click()  # in the middle
    lat, lon = map(float, tab.page.get_by_label("Position of beach.jpg").input_value().split(","))
    assert lat == pytest.approx(-17.0, abs=1e-4)
    assert abs(lon) == pytest.approx(180, abs=2e-5)
