"""What somebody typed, chose or looked at is there when they come back to it."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.browser.conftest import Open, Tab, taken
from tests.browser.test_console import ask
from tests.browser.test_console_enrolling import ASKS
from tests.browser.test_console_mishaps import JOB
from tests.sample_images import photo as drawn_photo
from tests.waiting import until

if TYPE_CHECKING:
    from playwright.sync_api import Route


def test_naming_one_spot_leaves_what_is_typed_of_the_others(opened: Open) -> None:
    """And whether positions are metres or degrees: a latitude must not become metres."""
    moments = {"first_at": "2026-03-01T12:00:00Z", "last_at": "2026-03-01T12:00:00Z"}
    spots = [
        {"id": name, "count": 1, "queries": [name], "links": {"image": f"/maps/town/unknown/{name}/image"}, **moments}
        for name in ("q1", "q2")
    ]

    def answered(route: "Route") -> None:
        if route.request.url.endswith("/image"):
            route.fulfill(body=drawn_photo(1), content_type="image/jpeg")
        elif route.request.method == "POST":
            del spots[0]
            route.fulfill(json={"views": [], "queries": 1})
        else:
            counts = {"keep_queries": 500, "kept": 2, "examined": 2, "count": len(spots)}
            route.fulfill(json={"map": "town", "places": spots, **counts})

    tab = opened("service")
    tab.page.route(re.compile("/maps/town/unknown"), answered)
    tab.show("maps/town/inbox")
    tab.page.get_by_label("Positions are in").select_option("degrees")
    one, other = tab.page.locator(".spot").nth(0), tab.page.locator(".spot").nth(1)
    other.get_by_label("What place is it?").fill("quay")
    other.get_by_label("Position, if known").fill("52.5, 13.4")
    one.get_by_label("What place is it?").fill("bridge")
    one.get_by_label("What place is it?").press("Enter")
    tab.awaits(".spot", 1)
    assert tab.page.get_by_label("What place is it?").input_value() == "quay"
    assert tab.page.get_by_label("Position, if known").input_value() == "52.5, 13.4"
    assert tab.page.get_by_label("Positions are in").input_value() == "degrees"


def test_images_that_were_on_their_way_when_the_answer_was_left_are_there_on_return(
    opened: Open, query_photo: Path
) -> None:
    """On a slow network; until they come they do not look broken."""
    tab = opened("ask", size={"width": 1280, "height": 2000})
    held: list[Route] = []
    slow = [True]
    tab.page.route(
        re.compile(r"/thumbnail(\?|$)"),
        lambda route: held.append(route) if slow else route.continue_(),
    )
    ask(tab, query_photo)
    tab.page.wait_for_function("document.querySelectorAll('.match img').length === 5")
    while len(held) < 6:  # as many as are fetched at once
        tab.page.wait_for_timeout(20)
    first = tab.page.locator(".match img").first
    assert first.evaluate("image => getComputedStyle(image).opacity") == "0"
    tab.show("maps")
    slow.clear()
    for route in held:
        route.continue_()
    tab.page.wait_for_timeout(500)
    tab.show("ask")
    tab.awaits(".match img[src^=blob]", 5)
    assert first.evaluate("image => getComputedStyle(image).opacity") == "1"


def test_a_photo_that_is_gone_since_is_not_taken_for_a_service_that_is_away(opened: Open, tmp_path: Path) -> None:
    photo = tmp_path / "today.jpg"
    photo.write_bytes(taken("mill lane", 25))
    tab = opened("ask")
    ask(tab, photo)
    photo.unlink()
    tab.page.get_by_role("button", name="Ask", exact=True).click()
    tab.page.get_by_text("The photo cannot be sent: its file was changed or removed; choose it again").wait_for()
    tab.complaints.clear()  # of the file


def test_a_tab_that_sends_a_snapshot_is_not_closed_without_a_word(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "town.tar").write_bytes(b"x" * 1000)
    tab = opened("snapshots", refusals=True)
    held: list[Route] = []
    tab.page.route("**/restore", lambda route: held.append(route))
    tab.page.get_by_label("Choose a snapshot file").set_input_files(tmp_path / "town.tar")
    assert not tab.page.evaluate(ASKS)
    tab.page.get_by_role("button", name="Restore", exact=True).click()
    while not held:
        tab.page.wait_for_timeout(20)
    assert tab.page.evaluate(ASKS)
    held[0].continue_()
    tab.page.locator("main").get_by_role("alert").wait_for()
    assert not tab.page.evaluate(ASKS)


def test_plans_that_are_shown_no_more_are_not_kept(opened: Open) -> None:
    """The window kept each, with its points, until the colours were changed."""
    tab = opened("service")
    for _ in range(5):
        tab.show("maps/town")
        tab.page.locator("canvas.plan[aria-label]").wait_for()
        tab.show("service")
    until(lambda: canvases(tab) <= 2)  # an answer that a page waits for when it is left holds its plan until it came


def canvases(tab: Tab) -> int:
    """How many canvases the window has once its garbage is collected."""
    session = tab.page.context.new_cdp_session(tab.page)
    canvas = session.send("Runtime.evaluate", {"expression": "HTMLCanvasElement.prototype"})["result"]["objectId"]
    kept = session.send("Runtime.queryObjects", {"prototypeObjectId": canvas})["objects"]["objectId"]
    call = {"objectId": kept, "functionDeclaration": "function () { return this.length; }", "returnByValue": True}
    try:
        return int(session.send("Runtime.callFunctionOn", call)["result"]["value"])
    finally:
        session.detach()


def test_a_snapshot_that_is_being_made_is_shown_to_who_comes_back(opened: Open) -> None:
    """Nothing told of it, and it did not come to the list when it was made."""
    job: dict[str, Any] = JOB | {"kind": "snapshot"}
    tab = opened("service")
    tab.page.route("**/jobs?kind=snapshot*", lambda route: route.fulfill(json={"jobs": [job], "next": None}))
    tab.page.route("**/jobs/j1", lambda route: route.fulfill(json=job))
    tab.show("snapshots")
    tab.page.get_by_text("town: 3 of 9 images").wait_for()
    tab.show("service")
    tab.show("snapshots")
    tab.page.get_by_text("town: 3 of 9 images").wait_for()
    with tab.page.expect_request("**/snapshots"):
        job |= {"state": "done", "progress": {"done": 9, "total": 9}}
    tab.page.locator("main").get_by_text("The snapshot of town is made.").wait_for()
    tab.awaits("progress[aria-label='Progress of the snapshot of town']", 0)


def test_what_became_of_a_restore_is_told_to_who_comes_back(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "town.tar").write_bytes(b"x" * 1000)
    tab = opened("snapshots", refusals=True)
    held: list[Route] = []
    tab.page.route("**/restore", lambda route: held.append(route))
    tab.page.get_by_label("Choose a snapshot file").set_input_files(tmp_path / "town.tar")
    tab.page.get_by_role("button", name="Restore", exact=True).click()
    while not held:
        tab.page.wait_for_timeout(20)
    tab.show("service")
    with tab.page.expect_response("**/restore"):
        held[0].continue_()
    tab.show("snapshots")
    tab.page.locator("main").get_by_role("alert").wait_for()
    assert "town.tar" in tab.page.locator("main").inner_text()
