"""Buttons that are pressed twice: what they do is done once."""

from typing import TYPE_CHECKING, Any

from app.http.examples import VIEW
from tests.browser.conftest import Open, Tab
from tests.sample_images import photo as drawn_photo

if TYPE_CHECKING:
    from playwright.sync_api import Route

MOMENTS = {"first_at": "2026-03-01T12:00:00Z", "last_at": "2026-03-01T12:00:00Z"}


def kept(tab: Tab, kind: str, counts: dict[str, Any], *, list_name: str, **row: Any) -> "list[Route]":
    """Let a map keep one query of a kind, and hold what is sent about it."""
    sent: list[Route] = []
    address = f"/maps/town/{kind}"
    one = {"id": "q1", "count": 1, "queries": ["q1"], "links": {"image": f"{address}/q1/image"}, **MOMENTS, **row}

    def answered(route: "Route") -> None:
        if route.request.method != "GET":
            sent.append(route)
        elif route.request.url.endswith("/image"):
            route.fulfill(body=drawn_photo(1), content_type="image/jpeg")
        else:
            route.fulfill(json={"map": "town", "count": 1, "kept": 1, "examined": 1, list_name: [one], **counts})

    tab.page.route(f"**{address}**", answered)
    return sent


def test_a_spot_is_named_once(opened: Open) -> None:
    """The second request was answered that there is no such query, though the photos were enrolled."""
    tab = opened("service")
    sent = kept(tab, "unknown", {"keep_queries": 500}, list_name="places")
    tab.show("maps/town/inbox")
    tab.page.get_by_label("What place is it?").fill("bridge")
    name = tab.page.get_by_role("button", name="Name it")
    name.dblclick()
    tab.page.get_by_label("What place is it?").press("Enter")
    tab.page.wait_for_timeout(200)
    assert [route.request.post_data_json for route in sent] == [{"place": "bridge"}]
    assert name.is_disabled()
    sent[0].fulfill(json={"views": [VIEW], "queries": 1})
    tab.page.locator("main").get_by_text("1 photo of bridge enrolled.").wait_for()


def test_a_proposal_is_taken_once_and_again_after_a_refusal(opened: Open) -> None:
    tab = opened("service", refusals=True)
    row = {"place": "mill lane", "confirmed": 2, "lowest_score": 0.4, "highest_score": 0.5}
    links = {"image": "/maps/town/proposals/q1/image", "view": f"/views/{VIEW['id']}"}
    sent = kept(tab, "proposals", {"keep_matches": 500}, list_name="proposals", **row, links=links)
    tab.page.route(f"**/views/{VIEW['id']}/thumbnail*", lambda route: route.fulfill(body=drawn_photo(2)))
    tab.show("maps/town/inbox")
    take = tab.page.get_by_role("button", name="Take", exact=True)
    take.dblclick()
    tab.page.wait_for_timeout(200)
    assert len(sent) == 1
    assert take.is_disabled()
    problem = {"title": "Too many", "status": 429, "detail": "again", "errors": [], "request_id": "r", "type": "urn:x"}
    sent[0].fulfill(status=429, json=problem)
    tab.page.get_by_role("alert").filter(has_text="Too many").wait_for()
    assert take.evaluate("button => button === document.activeElement")
    take.press("Enter")
    tab.page.wait_for_timeout(200)
    assert len(sent) == 2


def test_a_map_is_made_once(opened: Open) -> None:
    tab = opened("maps")
    sent: list[Route] = []
    tab.page.route("**/maps/twice", lambda route: sent.append(route))
    tab.page.get_by_text("New map", exact=True).click()
    tab.page.get_by_label("Name", exact=True).fill("twice")
    tab.page.get_by_role("button", name="Make the map").dblclick()
    tab.page.wait_for_timeout(200)
    assert len(sent) == 1
