"""What the console does while the service is slow, or away for a while: nothing goes to another map than was meant."""

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser.conftest import Open
from tests.browser.test_console import views
from tests.sample_images import photo as drawn_photo
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Route

MAPS = re.compile(r"/maps$")


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    paths = [tmp_path / f"{number}.jpg" for number in range(2)]
    for number, path in enumerate(paths):
        path.write_bytes(drawn_photo(570 + number))
    return paths


def test_photos_that_were_refused_go_to_the_map_that_was_typed_for_them(
    opened: Open, service: RunningService, photos: list[Path]
) -> None:
    """And not to the largest one, when they are tried again."""
    tab = opened("enrol", refusals=True)
    refused = {"title": "No", "status": 400, "detail": "not now", "errors": [], "request_id": "r", "type": "urn:x:no"}
    tab.page.route("**/enroll", lambda route: route.fulfill(status=400, json=refused))
    tab.page.get_by_label("or a new map").fill("attic")
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    tab.page.get_by_role("button", name="Enrol 2 photos").click()
    tab.page.locator("main").get_by_text("2 of 2 photos done, 2 refused.").wait_for()
    tab.page.unroute("**/enroll")
    before = len(views(service, "town"))
    tab.page.get_by_role("button", name="Try again: enrol 2 photos").click()
    tab.page.locator("main").get_by_text("2 of 2 photos done.").wait_for()
    assert (len(views(service, "town")), len(views(service, "attic"))) == (before, 2)
    tab.page.wait_for_function("document.querySelector('.fields select').value === 'attic'")
    assert tab.page.get_by_label("or a new map").input_value() == ""


def test_a_photo_goes_to_the_map_that_was_meant_though_the_maps_are_not_there_yet(
    opened: Open, query_photo: Path
) -> None:
    tab = opened("service")
    tab.page.evaluate("sessionStorage.setItem('revisit-map', 'town')")
    held: list[Route] = []
    tab.page.route(MAPS, lambda route: held.append(route))
    tab.page.goto(f"{tab.url}/#ask")
    tab.page.get_by_label("Choose a photo").set_input_files(query_photo)
    tab.page.get_by_text("Looking …").wait_for()
    with tab.page.expect_request("**/query**") as query:
        held[0].continue_()
    assert "map=town" in query.value.url
    tab.page.wait_for_selector(".verdict.matched")


def test_maps_that_did_not_come_are_fetched_again(
    opened: Open, service: RunningService, query_photo: Path, photos: list[Path]
) -> None:
    """The service was away when the screen was opened; it is there again when the photo is sent."""
    tab = opened("service")
    tab.page.route(MAPS, lambda route: route.abort())
    tab.page.goto(f"{tab.url}/#ask")
    tab.page.get_by_role("alert").filter(has_text="No answer").wait_for()
    tab.page.get_by_label("Choose a photo").set_input_files(query_photo)
    tab.page.locator("section").get_by_role("alert").filter(has_text="No answer").wait_for()
    tab.page.unroute(MAPS)
    tab.page.get_by_role("button", name="Ask", exact=True).click()
    tab.page.wait_for_selector(".verdict.matched")

    tab.page.route(MAPS, lambda route: route.abort())
    tab.page.goto(f"{tab.url}/#enrol")
    tab.page.get_by_role("alert").filter(has_text="No answer").wait_for()
    tab.page.unroute(MAPS)
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    before = len(views(service, "town"))
    tab.page.get_by_role("button", name="Enrol 2 photos").click()
    tab.page.locator("main").get_by_text("2 of 2 photos done.").wait_for()
    assert len(views(service, "town")) == before + 2
    tab.complaints.clear()  # of the maps that did not come


@pytest.mark.parametrize("screen", ["ask", "enrol", "maps", "maps/town", "maps/town/health", "maps/town/recipe"])
def test_a_screen_that_met_a_service_that_was_away_is_opened_once_more(opened: Open, screen: str) -> None:
    """Without loading the page again, which would lose the photos on Enrol."""
    tab = opened("service")
    api = re.compile(r"/maps(/town)?(/health.*)?$")
    tab.page.route(api, lambda route: route.abort())
    tab.page.goto(f"{tab.url}/#{screen}")
    away = tab.page.get_by_role("alert").filter(has_text="No answer")
    away.wait_for()
    tab.page.unroute(api)
    tab.page.get_by_role("button", name="Try again").press("Enter")
    away.wait_for(state="detached")
    tab.page.locator("main").get_by_text("town").first.wait_for(state="attached")
    tab.complaints.clear()  # of what did not come


def test_what_is_loaded_follows_the_service_and_what_is_unfolded_stays(opened: Open) -> None:
    """An upgrade, or a start, that happens while the screen is looked at."""
    tab = opened("maps")
    tab.page.route("**/version", lambda route: route.abort())
    tab.show("service")
    panel = tab.page.locator("section").filter(has=tab.page.get_by_role("heading", name="What is loaded"))
    panel.get_by_role("alert").wait_for()
    tab.page.unroute("**/version")
    panel.get_by_text("Libraries").click()
    tab.page.wait_for_timeout(6000)  # it has been looked at again
    assert panel.locator("details").get_attribute("open") is not None
    tab.complaints.clear()  # of what did not come


def test_a_problem_of_a_screen_that_was_left_is_not_shown_over_another(opened: Open) -> None:
    tab = opened()
    tab.page.evaluate(
        """() => {
            const real = window.fetch;
            window.late = [];
            const held = () => new Promise((_, reject) => window.late.push(reject));
            window.fetch = (address, options) => (address.endsWith("/maps") ? held() : real(address, options));
        }"""
    )
    tab.page.get_by_role("link", name="Maps", exact=True).click()
    tab.page.wait_for_function("() => late.length > 0")
    tab.show("service")
    for _ in range(2):  # it is asked for once more
        tab.page.wait_for_function("() => late.length > 0")
        tab.page.evaluate("late.pop()(new TypeError('reset'))")
    tab.page.get_by_text("GET /maps: ").wait_for()
    assert tab.page.locator("main > .spaced").count() == 0


@pytest.mark.parametrize("name", ["town%", "..", ".", "a%2Fb"])
@pytest.mark.parametrize("part", ["", "/health"])
def test_an_address_that_was_mistyped_is_told_as_the_name_of_no_map(opened: Open, name: str, part: str) -> None:
    """Of ".." a proxy was blamed, "." broke the screen, and of "town%" it was said that a URI is malformed."""
    tab = opened(f"maps/{name}{part}")
    told = tab.page.get_by_role("alert").inner_text()
    assert "There is no such map: " in told
    assert "Letters, digits, dots, hyphens" in told
    tab.page.get_by_role("link", name="All maps").click()
    tab.page.get_by_role("link", name="town", exact=True).wait_for()


def test_an_address_of_no_screen_is_that_of_the_first(opened: Open) -> None:
    """Of #main, which is where the link that skips the head leads in a tab of its own, nothing was shown."""
    opened("main").page.get_by_role("heading", name="Where was this taken?").wait_for()


def test_a_problem_that_lasts_is_told_once(opened: Open) -> None:
    """Every 5 s it was read out anew to those who listen, and flickered."""
    away = re.compile(r"/(readyz|metrics|version)$|/jobs[?]")
    looks: list[str] = []

    def refuse(route: "Route") -> None:
        looks.append(route.request.url)
        route.abort()

    tab = opened("maps")
    tab.page.route(away, refuse)
    tab.show("service")
    alerts = tab.page.get_by_role("alert")
    tab.awaits("[role=alert]", 4)
    for alert in alerts.all():
        alert.evaluate("alert => (alert.dataset.seen = 'yes')")
    before = len(looks)
    while len(looks) < before + 10:
        tab.page.wait_for_timeout(100)
    tab.awaits("[role=alert][data-seen=yes]", 4)
    tab.page.unroute(away)
    tab.awaits("[role=alert]", 0)
    tab.complaints.clear()  # of what did not come
