"""What the console shows of photos: what a map blurs and keeps, what a deletion leaves, and what changed at a place.

And which tables of positions it refuses.
"""

from pathlib import Path
from typing import Any

import httpx
import pytest

from lab.faults.heics import heics
from scenes import Scene, scene
from scenes.refurnishing import Piece, furnished
from tests.browser.conftest import Open, Tab
from tests.browser.test_console_maps import check, enrolled, seen
from tests.stories.photos import jpeg
from tests.stories.running import RunningService
from tests.waiting import until

HALL = scene("corridor refurnished")
CUPBOARD, CHAIR = Piece("cupboard", -0.8, 4.0, 1), Piece("chair", 0.7, 3.6, 2)


def taken(look: Scene, *pieces: Piece) -> bytes:
    return jpeg(furnished(look, pieces)[0])


def facts(service: RunningService, name: str) -> Any:
    return httpx.get(f"{service.url}/maps/{name}").json()


def made(service: RunningService, name: str) -> None:
    httpx.put(f"{service.url}/maps/{name}", json={}, timeout=60).raise_for_status()


# filters


def test_a_filter_of_metadata_without_a_value_is_refused(opened: Open, query_photo: Path) -> None:
    """It was left out without a word, so that the answer was of all views."""
    tab = opened()
    tab.page.get_by_text("Filters and more").click()
    tab.page.get_by_label("Metadata", exact=True).fill("floor")
    tab.page.get_by_label("Choose a photo").set_input_files(query_photo)
    tab.page.get_by_role("alert").filter(has_text="as in floor=2; not floor").wait_for()
    tab.page.get_by_label("Metadata", exact=True).fill("floor = 2")
    with tab.page.expect_request("**/query?**") as query:
        tab.page.get_by_role("button", name="Ask").click()
    assert "metadata.floor=2" in query.value.url.split("?")[1].split("&")
    tab.page.get_by_role("heading", name="Not recognised").wait_for()


# formats that the browser does not know


def test_a_photo_that_the_browser_cannot_show_is_queried_and_enrolled_all_the_same(
    opened: Open, tmp_path: Path
) -> None:
    """The picture of a broken image was drawn as large as the photo, with lines to its corners."""
    (tmp_path / "phone.heic").write_bytes(heics()["plain"])
    tab = opened()
    tab.page.get_by_label("Choose a photo").set_input_files(tmp_path / "phone.heic")
    tab.page.locator("svg.pairs text", has_text="this browser cannot show it").wait_for()
    assert tab.page.locator("svg.pairs image").count() == 1
    tab.page.wait_for_function("() => document.querySelector('svg.pairs image').href.baseVal.startsWith('blob:')")

    tab.show("enrol")
    tab.page.get_by_label("Choose photos").set_input_files(tmp_path / "phone.heic")
    tab.awaits(".files .not-shown", 1)
    tab.page.get_by_label("or a new map").fill("phones")
    tab.page.get_by_role("button", name="Enrol 1 photo").click()
    tab.page.locator(".files .done").wait_for()
    assert tab.page.locator(".files img").count() == 0

    tab.show("maps/phones")
    tab.shows_its_images()  # the service's own are JPEG


# what becomes of photos


def test_what_is_blurred_is_chosen_before_the_first_photo_and_only_less_after(
    opened: Open, service: RunningService
) -> None:
    made(service, "lobby")
    tab = opened("maps/lobby", bypass_csp=True)
    tab.page.get_by_label("People").check()
    tab.page.get_by_label("Vehicles").check()
    check(tab, "what is blurred")
    tab.page.get_by_role("button", name="Change what is blurred").press("Enter")
    tab.page.locator("#announce", has_text="Blurred before storing: people, vehicles.").wait_for(state="attached")
    assert facts(service, "lobby")["blur"] == ["people", "vehicles"]

    enrolled(service, "lobby", seen("mill lane"), place="lobby")
    tab.page.reload()
    tab.page.get_by_label("Vehicles").uncheck()
    tab.page.get_by_role("button", name="Change what is blurred").click()
    assert "show vehicles" in tab.page.locator("dialog").inner_text()
    tab.page.get_by_role("button", name="Blur less").click()
    tab.page.locator("#announce", has_text="Blurred before storing: people.").wait_for(state="attached")
    assert facts(service, "lobby")["blur"] == ["people"]
    assert tab.page.get_by_label("Vehicles").is_disabled()


def test_a_map_forgets_its_images_once_its_name_is_typed(opened: Open, service: RunningService) -> None:
    enrolled(service, "attic", seen("rose garden"), place="attic")
    tab = opened("maps/attic", bypass_csp=True)
    tab.awaits(".grid img[src^=blob]", 1)
    tab.page.get_by_role("button", name="Keep no images …").click()
    assert tab.page.get_by_role("button", name="Keep no images", exact=True).is_disabled()
    tab.page.get_by_label("To go on, type attic").fill("attic")
    tab.confirm("Keep no images")
    tab.page.get_by_role("heading", name="Images are not kept").wait_for()
    assert facts(service, "attic")["keep_images"] is False
    assert tab.page.get_by_role("button", name="Keep images").is_disabled()
    view = tab.page.get_by_label("View 1: attic")
    assert "image not kept" in view.inner_text()
    view.click()
    tab.page.get_by_role("dialog").get_by_text("Image not kept.").wait_for()
    tab.page.get_by_role("button", name="Close").click()

    made(service, "cellar")
    tab.show("maps/cellar")
    tab.page.get_by_role("button", name="Keep no images …").click()
    tab.confirm("Keep no images")
    tab.page.get_by_role("button", name="Keep images").click()
    tab.page.get_by_role("heading", name="Images are kept").wait_for()
    assert facts(service, "cellar")["keep_images"] is True


def test_what_a_map_refuses_is_said(opened: Open, service: RunningService) -> None:
    made(service, "porch")
    tab = opened("maps/porch", refusals=True)
    tab.page.get_by_label("People").check()
    enrolled(service, "porch", seen("mill lane"), place="porch")  # somebody else is quicker
    tab.page.get_by_role("button", name="Change what is blurred").click()
    assert "blur them in a new map" in tab.page.get_by_role("alert").inner_text()


# receipts


def test_a_receipt_says_what_is_gone_and_which_snapshots_have_it(opened: Open, service: RunningService) -> None:
    for place in ("mill lane", "rose garden"):
        enrolled(service, "yard", seen(place), place=place)
    job = httpx.post(f"{service.url}/maps/yard/snapshots", timeout=60).json()
    until(lambda: httpx.get(f"{service.url}/jobs/{job['id']}").json()["state"] == "done")
    tab = opened("maps/yard", bypass_csp=True)
    tab.page.get_by_label("View 1: mill lane").click()
    tab.page.get_by_role("button", name="Delete this view …").click()
    tab.confirm("Delete the view")
    receipt = tab.page.locator("dialog.receipt")
    receipt.get_by_role("heading", name="The view is deleted").wait_for()
    assert "has 1 view of it" in receipt.inner_text()
    receipt.get_by_role("button", name="Close").press("Enter")
    tab.page.get_by_label("View 1: rose garden").wait_for()

    tab.page.get_by_role("button", name="Delete this map …").click()
    tab.page.get_by_label("To go on, type yard").fill("yard")
    tab.confirm("Delete the map")
    receipt.get_by_role("heading", name="The map yard is deleted").wait_for()
    text = receipt.inner_text()
    assert "1 view" in text
    assert "has 1 view of it" in text
    check(tab, "a receipt")
    receipt.get_by_label("Delete the snapshot of yard").click()
    tab.confirm("Delete the snapshot")
    until(lambda: all(one["map"] != "yard" for one in httpx.get(f"{service.url}/snapshots").json()["snapshots"]))
    receipt.get_by_role("button", name="Close").click()
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()


# what changed


@pytest.fixture(scope="module")
def house(service: RunningService) -> str:
    """A hall then and now: a cupboard is gone, a chair is new; and a place that has nothing to do with it."""
    enrolled(service, "house", taken(HALL, CUPBOARD), place="hall", captured_at="2026-03-01T09:00:00Z")
    enrolled(service, "house", taken(HALL, CHAIR), place="hall", captured_at="2026-06-01T09:00:00Z")
    enrolled(service, "house", seen("rose garden"), place="hall", captured_at="2026-04-01T09:00:00Z")
    enrolled(service, "house", seen("mill lane"), place="mill lane")
    return "house"


@pytest.fixture
def today(tmp_path: Path) -> Path:
    path = tmp_path / "today.jpg"
    path.write_bytes(taken(HALL.seen_from(dx=0.1, turn=1)))
    return path


def ask(tab: Tab, path: Path, map_name: str) -> None:
    tab.page.get_by_label("Map", exact=True).select_option(map_name)
    tab.page.get_by_label("Choose a photo").set_input_files(path)
    tab.page.wait_for_selector(".verdict")


def test_what_changed_is_told_and_drawn_below_an_answer(opened: Open, house: str, today: Path) -> None:
    tab = opened(bypass_csp=True)
    ask(tab, today, house)
    tab.page.get_by_role("button", name="What changed here?").press("Enter")
    tab.page.get_by_role("heading", name="What changed", exact=True).wait_for()
    assert "Gone" in tab.page.locator(".told-changes").inner_text()
    tab.awaits(".changes figure img[src^=blob]", 1)
    check(tab, "what changed")


def test_a_view_is_compared_with_an_earlier_one_of_its_place(opened: Open, service: RunningService, house: str) -> None:
    tab = opened(f"maps/{house}", bypass_csp=True)
    tab.page.get_by_label("View 2: hall").click()
    others = tab.page.get_by_label("Another view from here")
    assert "1 Apr 2026" in others.locator("option:checked").inner_text()  # the one before
    tab.page.get_by_role("button", name="What changed?").click()
    tab.page.get_by_role("heading", name="The photos cannot be laid over one another").wait_for()
    assert "12 are needed" in tab.page.locator(".changes").inner_text()
    others.select_option(index=0)
    assert tab.page.locator(".changes h3").count() == 0
    tab.page.get_by_role("button", name="What changed?").click()
    tab.page.get_by_role("heading", name="What changed", exact=True).wait_for()
    assert {"Gone", "New"} <= set(tab.page.locator(".told-changes strong").all_inner_texts())
    tab.awaits(".changes figure img[src^=blob]", 1)
    check(tab, "what changed at a view")


def test_why_nothing_can_be_compared_is_said(opened: Open, service: RunningService) -> None:
    httpx.put(f"{service.url}/maps/gone", json={}, timeout=60).raise_for_status()
    httpx.patch(f"{service.url}/maps/gone", json={"keep_images": False}, timeout=60).raise_for_status()
    for quality in (90, 80):
        enrolled(service, "gone", seen("mill lane", quality), place="mill lane")
    tab = opened("maps/gone", refusals=True)
    tab.page.get_by_label("View 1: mill lane").click()
    tab.page.get_by_role("button", name="What changed?").click()
    assert "image" in tab.page.locator("dialog .changes [role=alert]").inner_text()


def test_a_busy_service_is_tried_again_by_hand(opened: Open, house: str) -> None:
    tab = opened(f"maps/{house}", refusals=True)
    busy = {
        "type": "urn:revisit:problem:busy",
        "title": "The service is busy",
        "status": 429,
        "detail": "too many wait",
    }
    tab.page.route("**/changes?since=*", lambda route: route.fulfill(status=429, json=busy))
    tab.page.get_by_label("View 2: hall").click()
    tab.page.get_by_role("button", name="What changed?").click()
    tab.page.get_by_text("The service is busy: try again in a few seconds.").wait_for()
    tab.awaits_enabled("What changed?")
    tab.page.unroute("**/changes?since=*")
    tab.page.get_by_role("button", name="What changed?").click()
    tab.page.locator("dialog .changes h3").wait_for()


def test_a_table_that_cannot_be_used_says_why(opened: Open, tmp_path: Path) -> None:
    tab = opened("enrol")
    for text, reason in (
        ("name,x\na.jpg,1\n", "the first line needs to name columns"),
        ("file,x,why\na.jpg,1,2\n", "unknown columns why"),
        ("file,x,y\na.jpg,one,2\n", "row 1: x is one, which is no number"),
        ("file,x,y\na.jpg,1,5,2,5\n", "row 1: 5 values, and the first line names 3 columns"),
        ("file,x,y,heading\na.jpg,1,,90\n", "row 1: x or y is missing"),
        ("file,x,x\na.jpg,1,2\n", "names a column twice"),
        ("file,x,y\n,1,2\n", "row 1: names no file"),
        ('file,place\na.jpg,"hall\nb.jpg,roof\n', "a quoted value is not closed"),
        ("file,x,y\na.jpg,1,2\n./a.jpg,3,4\n", "row 2: an earlier one is about a.jpg too"),
        ("file,x,y,lat,lon\na.jpg,1,2,,\nb.jpg,,,3,4\n", "some rows have x and y, others lat and lon"),
    ):
        table = tmp_path / "positions.csv"
        table.write_text(text)
        tab.page.get_by_label("Positions (CSV)").set_input_files(table)
        tab.page.get_by_role("alert").filter(has_text=reason).wait_for()
