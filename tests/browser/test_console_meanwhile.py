"""What others change, or a key that ends, while somebody looks at a view."""

from typing import TYPE_CHECKING, Any

import httpx
import pytest

from tests.browser.conftest import Open, Tab
from tests.browser.test_console_keys import Locked, locked, sign_in
from tests.sample_images import photo as drawn_photo
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import APIResponse, Route

__all__ = ["locked"]  # a fixture


def put(service: RunningService, seed: int, **fields: str) -> dict[str, Any]:
    answer = httpx.post(f"{service.url}/enroll", files={"image": drawn_photo(seed)}, data=fields, timeout=60)
    view: dict[str, Any] = answer.raise_for_status().json()["view"]
    return view


def unfold(tab: Tab) -> None:
    tab.page.get_by_role("dialog").get_by_text("Edit", exact=True).click()


def test_an_edit_changes_what_was_typed_alone(opened: Open, service: RunningService) -> None:
    """The name and the position that others gave meanwhile were taken back."""
    metadata_now = '{"floor": 1, "code": 12345678901234567890}'
    view = put(service, 700, map="edited-here", place="old name", x="1", y="2", metadata=metadata_now)
    address = f"{service.url}/views/{view['id']}"
    tab = opened("maps/edited-here")
    tab.page.get_by_role("button", name="View 1: old name").click()
    httpx.patch(address, json={"place": "new name", "position": {"x": 5, "y": 6}}).raise_for_status()
    unfold(tab)
    metadata = tab.page.get_by_label("Metadata, a JSON object")
    metadata.fill(metadata.input_value().replace('"floor": 1', '"floor": 2'))
    tab.page.get_by_role("button", name="Save").click()
    tab.page.get_by_role("dialog").wait_for(state="detached")
    now = httpx.get(address).json()
    assert (now["place"], now["position"]["x"], now["position"]["y"]) == ("new name", 5, 6)
    assert now["metadata"] == {"floor": 2, "code": 12345678901234567890}


@pytest.mark.parametrize("how", ["edited", "deleted"])
def test_a_view_that_others_deleted_leaves_the_list_once_its_dialog_is_closed(
    opened: Open, service: RunningService, how: str
) -> None:
    name = f"gone-{how}"
    put(service, 710, map=name, place="stays")
    view = put(service, 711, map=name, place="goes")
    tab = opened(f"maps/{name}", refusals=True)
    tab.page.get_by_role("button", name="goes 1 view").click()
    tab.page.get_by_role("button", name="View 1: goes").click()
    tab.page.locator("dialog img[src]").wait_for()
    tab.shows_its_images()
    httpx.delete(f"{service.url}/views/{view['id']}").raise_for_status()
    if how == "edited":
        unfold(tab)
        tab.page.get_by_label("Place", exact=True).fill("another")
        tab.page.get_by_role("button", name="Save").click()
    else:
        tab.page.get_by_role("button", name="Delete this view …").click()
        tab.confirm("Delete the view")
    tab.page.get_by_role("dialog").get_by_text("there is no view").wait_for()
    tab.page.keyboard.press("Escape")
    tab.page.get_by_role("heading", name="All views").wait_for()
    tab.awaits('.names [data-place="goes"]', 0)


def test_an_edit_that_a_key_ended_under_is_saved_and_shown_with_the_next_key(opened: Open, locked: Locked) -> None:
    """It was saved, and the map behind it went on showing what had been there."""
    service, keys = locked
    tab = opened("maps/vault", url=service.url, refusals=True)
    sign_in(tab, keys["admin"])
    tab.page.get_by_role("button", name="View 1: door").click()
    tab.page.locator("dialog img[src]").wait_for()
    unfold(tab)
    tab.page.get_by_label("Place", exact=True).fill("gate")
    tab.page.evaluate("sessionStorage.setItem('revisit-key', 'rv_ended')")
    tab.page.get_by_role("button", name="Save").click()
    tab.page.locator("#sign-in").wait_for()
    sign_in(tab, keys["admin"])
    tab.page.locator("#sign-in").wait_for(state="detached")
    tab.page.get_by_role("button", name="Save").click()
    tab.page.get_by_role("button", name="View 1: gate").wait_for()
    tab.awaits("dialog", 0)


def test_an_open_map_and_the_list_of_maps_follow_what_others_enrol_and_delete(
    opened: Open, service: RunningService
) -> None:
    """They stayed as they had been opened until they were opened again."""
    put(service, 720, map="shared", place="porch")
    tab, listed = opened("maps/shared", refusals=True), opened("maps")
    row = listed.page.get_by_role("row").filter(has=listed.page.get_by_role("link", name="shared", exact=True))
    row.get_by_role("link").focus()
    tab.page.get_by_role("button", name="View 1: porch").focus()
    put(service, 721, map="shared", place="attic", x="1", y="2")
    tab.page.get_by_role("button", name="View 2: attic").wait_for()
    tab.page.get_by_role("button", name="attic 1 view").wait_for()
    tab.page.get_by_role("heading", name="Plan").wait_for()
    assert tab.page.evaluate("document.activeElement.ariaLabel") == "View 1: porch"
    row.get_by_role("cell", name="2", exact=True).first.wait_for()
    assert row.get_by_role("link").evaluate("link => link === document.activeElement")
    httpx.delete(f"{service.url}/maps/shared", timeout=60).raise_for_status()
    row.wait_for(state="detached")
    tab.page.get_by_role("alert").filter(has_text="there is no map 'shared'").wait_for()


def test_an_answer_from_before_a_change_does_not_take_it_back(opened: Open, service: RunningService) -> None:
    """On a slow network: it is looked at every few seconds."""
    put(service, 730, map="slow", place="porch")
    tab = opened("maps/slow")
    held: list[tuple[Route, APIResponse]] = []

    def hold(route: "Route") -> None:
        if route.request.method == "GET" and not held:
            held.append((route, route.fetch()))
        else:
            route.continue_()

    tab.page.route("**/maps/slow", hold)
    while not held:
        tab.page.wait_for_timeout(100)
    precision = tab.page.get_by_label("Share of sure answers that must be right")
    precision.fill("0.9")
    with tab.page.expect_response(lambda answer: answer.request.method == "GET" and answer.url.endswith("/maps/slow")):
        precision.press("Enter")
    tab.page.wait_for_timeout(200)
    route, before = held[0]
    with tab.page.expect_response("**/maps/slow"):
        route.fulfill(response=before)
    tab.page.wait_for_timeout(200)
    assert precision.input_value() == "0.9"
