"""What the console does where something goes wrong midway: keys that end, pages that do not come, jobs of others."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from app.http.examples import VIEW
from tests.browser.conftest import PLACES, Open, Tab
from tests.browser.test_console import enrolled, views
from tests.browser.test_console_keys import Locked, locked, sign_in
from tests.sample_images import photo as drawn_photo
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Route

__all__ = ["locked"]  # a fixture

JOB = {
    "id": "j1", "kind": "recipe", "state": "running", "map": "town", "view": None, "attempts": 1, "failure": None,
    "progress": {"done": 3, "total": 9}, "result": None, "created_at": "2026-03-01T12:00:00Z", "finished_at": None,
}  # fmt: skip

BUSY = {
    "type": "urn:revisit:problem:too-many-requests", "title": "Too many requests", "status": 429,
    "detail": "try again", "errors": [], "request_id": "r",
}  # fmt: skip


def is_focused(tab: Tab, selector: str) -> bool:
    found: bool = tab.page.evaluate("selector => document.activeElement.matches(selector)", selector)
    return found


def test_photos_and_what_was_typed_outlive_a_key_that_ends(opened: Open, locked: Locked, tmp_path: Path) -> None:
    service, keys = locked
    photos = [tmp_path / f"{number}.jpg" for number in range(3)]
    for number, path in enumerate(photos):
        path.write_bytes(drawn_photo(500 + number))
    tab = opened("enrol", url=service.url, refusals=True)
    sign_in(tab, keys["admin"])
    tab.page.get_by_role("dialog").wait_for(state="detached")
    tab.page.get_by_label("or a new map").fill("cellar")
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    tab.page.get_by_label("Place of 1.jpg").fill("wine")
    tab.page.evaluate("sessionStorage.setItem('revisit-key', 'rv_ended')")
    tab.page.get_by_role("button", name="Enrol 3 photos").click()
    tab.page.get_by_role("dialog").wait_for()
    sign_in(tab, keys["admin"])
    tab.page.get_by_role("dialog").wait_for(state="detached")

    tab.page.get_by_label("or a new map").fill("cellar")
    tab.page.get_by_role("button", name=re.compile("nrol 3 photos")).click()
    tab.page.locator("main").get_by_text("3 of 3 photos done.").wait_for()
    listed = httpx.get(f"{service.url}/views?map=cellar", headers={"x-api-key": keys["admin"]}).json()["views"]
    assert sorted(str(one["place"]) for one in listed) == ["None", "None", "wine"]


def test_a_service_that_starts_again_is_waited_for_and_a_file_that_is_gone_is_named(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    photos = [tmp_path / f"{number}.jpg" for number in range(3)]
    for number, path in enumerate(photos):
        path.write_bytes(drawn_photo(550 + number))
    tab = opened("enrol")
    tab.page.evaluate(
        """() => {
            const real = window.fetch;
            let left = 2;
            const fails = (address) => address.includes("/enroll") && left-- > 0;
            window.fetch = (address, options) =>
                fails(address) ? Promise.reject(new TypeError("reset")) : real(address, options);
        }"""
    )
    tab.page.get_by_label("or a new map").fill("again")
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    tab.page.get_by_label("Place of 2.jpg").wait_for()
    photos[2].unlink()
    tab.remember(".files li")
    tab.page.get_by_role("button", name="Enrol 3 photos").click()
    tab.page.locator("main").get_by_text("3 of 3 photos done, 1 refused.").wait_for()
    assert any("the service does not answer; again in 2 s" in text for text in tab.remembered())
    [refused] = tab.page.locator(".files .refused").all_inner_texts()
    assert refused == "The file cannot be sent. Was it changed or removed? Choose it again"
    assert len(views(service, "again")) == 2
    tab.complaints.clear()  # of the file


def test_files_of_the_console_that_did_not_arrive_are_fetched_again(opened: Open) -> None:
    tab = opened("maps")
    for file, times in (("parts.css", 2), ("dom.js", 1)):
        tab.page.route(f"**/console/{file}", lambda route: route.abort(), times=times)
    tab.remember("[role=alert]")
    tab.page.reload()
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()
    first, second = tab.remembered()
    assert re.search(r"arrived \(.*/console/main\.js.*\)", first)
    assert "(/console/parts.css). It is loaded again in 2 s" in second
    assert tab.page.evaluate("sessionStorage.getItem('revisit-reloads')") is None
    tab.complaints.clear()  # of the files


def test_files_that_never_arrive_are_named_and_not_fetched_for_ever(opened: Open) -> None:
    tab = opened("maps")
    tab.page.route("**/console/dom.js", lambda route: route.abort())
    tab.page.reload()
    tab.page.get_by_role("alert").filter(has_text="(/console/main.js), 4 times").wait_for()
    tab.page.unroute("**/console/dom.js")
    tab.page.reload()
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()
    tab.complaints.clear()  # of the files


def test_what_was_dropped_on_the_way_is_fetched_again(opened: Open, service: RunningService) -> None:
    enrolled(service, "dropped", range(540, 541), place="porch")
    tab = opened("maps/dropped")
    dropped: list[str] = []

    def drop(route: "Route") -> None:
        dropped.append(route.request.url)
        route.abort()

    tab.page.route(re.compile("/maps/dropped$"), drop, times=1)
    tab.page.reload()
    tab.page.get_by_label("View 1: porch").wait_for()
    assert dropped
    tab.complaints.clear()  # of what was dropped


def test_a_key_that_can_be_none_is_told_from_a_service_that_is_away(opened: Open, locked: Locked) -> None:
    service, _ = locked
    tab = opened("maps", url=service.url, refusals=True)
    sign_in(tab, "rv_12…")
    assert "the key has letters that no key has" in tab.page.get_by_role("dialog").get_by_role("alert").inner_text()


def test_a_page_of_views_that_did_not_come_is_told_and_fetched_again(opened: Open) -> None:
    total, refuse = 1000, [True]

    def answered(route: "Route") -> None:
        url = httpx.URL(route.request.url)
        if url.path == "/views":
            begin, limit = int(url.params.get("cursor", "0")), int(url.params["limit"])
            if begin and refuse:
                route.fulfill(status=429, json=BUSY, content_type="application/problem+json")
                return
            rows = [VIEW | {"id": f"v{row:05}", "place": f"place {row}"} for row in range(begin, begin + limit)]
            route.fulfill(json={"views": rows, "next": str(begin + limit) if begin + limit < total else None})
        elif url.path.endswith("/thumbnail"):
            route.fulfill(body=drawn_photo(1), content_type="image/jpeg")
        else:
            facts = route.fetch().json()
            route.fulfill(json=facts | {"views": {"ready": total}, "places": 0, "extent": None})

    tab = opened("service", refusals=True)
    tab.page.route(re.compile(r"/views|/maps/town$"), answered)
    tab.show("maps/town")
    grid = tab.page.get_by_role("region", name="Thumbnails of views")
    tab.page.get_by_label("View 1: place 0", exact=True).wait_for()
    grid.evaluate("grid => { grid.scrollTop = grid.scrollHeight }")
    tab.page.get_by_role("alert").filter(has_text="Too many requests").wait_for()

    refuse.clear()
    tab.page.get_by_role("button", name="Try again").press("Enter")
    tab.page.get_by_label("View 1000: place 999").wait_for()
    assert tab.page.get_by_role("alert").count() == 0


def test_jobs_are_followed_past_the_first_that_ends_and_past_a_refusal(opened: Open) -> None:
    """And the button that cancels one keeps the focus while the list is drawn anew."""
    looks: list[int] = []

    def answered(route: "Route") -> None:
        if "kind=describe" in route.request.url:
            route.fulfill(json={"jobs": [], "next": None})
            return
        looks.append(1)
        if len(looks) == 3:
            route.fulfill(status=429, json=BUSY, content_type="application/problem+json")
            return
        first: dict[str, Any] = JOB | {"id": "j0", "state": "running" if len(looks) == 1 else "done"}
        second = JOB | {"state": "running" if len(looks) < 6 else "done", "progress": {"done": len(looks), "total": 9}}
        route.fulfill(json={"jobs": [second, first], "next": None})

    tab = opened("ask", refusals=True)
    tab.page.route(re.compile(r"/jobs\?"), answered)
    tab.show("service")
    jobs = tab.page.get_by_role("region", name="Jobs")
    jobs.get_by_role("button", name="Cancel").first.focus()
    jobs.get_by_text("2 of 9 images").wait_for()
    assert is_focused(tab, "[data-job=j1]")
    jobs.get_by_text("4 of 9 images").wait_for()
    jobs.get_by_text("6 of 9 images").wait_for()
    assert jobs.get_by_role("button", name="Cancel").count() == 0


def test_the_plan_follows_the_map_that_is_chosen(opened: Open, service: RunningService, tmp_path: Path) -> None:
    enrolled(service, "annex", range(510, 511), x="5", y="5")
    (tmp_path / "a.jpg").write_bytes(drawn_photo(511))
    tab = opened("enrol", refusals=True)
    tab.page.get_by_label("Map", exact=True).select_option("town")
    tab.page.get_by_label("Choose photos").set_input_files(tmp_path / "a.jpg")
    tab.page.get_by_text("Set positions on the plan").click()
    plan = "canvas.plan[aria-label='Plan with {}']"
    tab.page.locator(plan.format(f"{2 * len(PLACES)} positions")).wait_for()
    tab.page.get_by_label("Map", exact=True).select_option("annex")
    tab.page.locator(plan.format("1 position")).wait_for()
    tab.page.get_by_label("or a new map").fill("brand-new")
    tab.page.get_by_label("or a new map").press("Tab")
    tab.page.get_by_text("This map has no positions yet").wait_for()


def test_what_is_taken_out_of_nested_metadata_is_gone(opened: Open, service: RunningService) -> None:
    fields = {"metadata": '{"floor": {"number": 2, "name": "attic"}, "run": 1}'}
    enrolled(service, "nested", range(520, 521), **fields)
    tab = opened("maps/nested", refusals=True)

    def edit(text: str) -> None:
        dialog = tab.page.get_by_role("dialog")
        dialog.get_by_label("Metadata, a JSON object").fill(text)
        dialog.get_by_role("button", name="Save").press("Enter")

    tab.page.locator(".grid .cell button").press("Enter")
    tab.page.get_by_text("Edit", exact=True).press("Enter")
    edit('["floor"]')
    tab.page.get_by_role("dialog").get_by_role("alert").filter(has_text="not a JSON object").wait_for()
    edit('{"floor": {"number": 3}}')
    tab.page.get_by_role("dialog").wait_for(state="detached")
    assert views(service, "nested")[0]["metadata"] == {"floor": {"number": 3}}


def test_the_keyboard_stays_where_the_work_is(opened: Open, service: RunningService) -> None:
    enrolled(service, "porch", range(530, 532), place="porch")
    tab = opened("maps")
    tab.page.get_by_role("link", name="porch").press("Enter")
    tab.page.get_by_role("heading", name="porch").first.wait_for()
    assert is_focused(tab, "main")
    tab.page.locator(".grid .cell button").first.press("Enter")
    tab.page.get_by_text("Edit", exact=True).press("Enter")
    tab.page.get_by_role("dialog").get_by_label("Place").fill("front porch")
    tab.page.get_by_role("dialog").get_by_label("Place").press("Enter")
    tab.page.get_by_label("View 1: front porch").wait_for()
    tab.page.wait_for_function("document.activeElement.ariaLabel === 'View 1: front porch'")


def test_a_map_that_was_deleted_elsewhere_leads_back_to_the_others(opened: Open) -> None:
    tab = opened("maps/gone", refusals=True)
    tab.page.get_by_role("alert").filter(has_text="there is no map 'gone'").wait_for()
    assert "Loading" not in tab.page.locator("main").inner_text()
    tab.page.get_by_role("link", name="All maps").press("Enter")
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()


def test_another_order_keeps_the_place_that_is_shown(opened: Open) -> None:
    tab = opened("maps/town")
    tab.awaits(".grid .cell", 2 * len(PLACES))
    tab.page.get_by_role("button", name=re.compile("^rose garden")).click()
    tab.awaits(".grid .cell", 2)
    tab.page.get_by_label("Order").select_option("newest first")
    tab.page.get_by_role("heading", name="rose garden").wait_for()
    tab.awaits(".grid .cell", 2)


def test_a_long_name_makes_no_screen_wider_than_a_small_phone(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    name, place = "m" * 64, "Verwaltungsgebäudehintereingang" * 6
    enrolled(service, name, range(540, 542), place=place, x="1", y="2")
    (tmp_path / f"{'a' * 90}.jpg").write_bytes(drawn_photo(540))
    tab = opened("ask", size={"width": 320, "height": 640})
    tab.page.get_by_label("Map", exact=True).select_option(name)
    tab.page.get_by_label("Choose a photo").set_input_files(tmp_path / f"{'a' * 90}.jpg")
    tab.page.wait_for_selector(".verdict")
    assert not tab.is_wider_than_the_window()
    for screen in (
        "enrol",
        "maps",
        "service",
        "snapshots",
        *(f"maps/{name}{part}" for part in ("/health", "/recipe", "")),
    ):
        tab.show(screen)
        assert not tab.is_wider_than_the_window(), screen
    tab.page.locator(".grid .cell button").first.click()
    wide = "dialog => dialog.scrollWidth > dialog.clientWidth"
    assert not tab.page.get_by_role("dialog").evaluate(wide)
    tab.page.get_by_role("button", name="Close").click()
    tab.page.get_by_role("button", name="Delete this map …").click()
    assert not tab.page.get_by_role("dialog").evaluate(wide)


def test_what_a_verdict_was_made_from_is_legible_on_a_small_phone(opened: Open, query_photo: Path) -> None:
    """Its values had room for one letter in a line."""
    tab = opened(size={"width": 320, "height": 640})
    tab.page.get_by_label("Map", exact=True).select_option("town")
    tab.page.get_by_label("Choose a photo").set_input_files(query_photo)
    tab.page.get_by_text("What the verdict was made from").click()
    shares = "rows => rows.map((row) => row.offsetWidth / row.parentElement.clientWidth)"
    assert min(tab.page.locator("dl:visible dd").evaluate_all(shares)) > 0.4


def test_a_service_that_is_away_is_told_from_a_fault_of_the_console(opened: Open) -> None:
    tab = opened("service")
    checks = tab.page.locator("section").filter(has=tab.page.get_by_role("heading", name="Is it well?"))
    checks.get_by_text("Ready", exact=True).wait_for()
    tab.page.route("**/readyz", lambda route: route.abort())
    checks.get_by_text("No answer: the service cannot be reached; is it running?").wait_for()
    tab.page.unroute("**/readyz")
    tab.page.route("**/readyz", lambda route: route.fulfill(status=502, body="<h1>Bad Gateway</h1>"))
    checks.get_by_text("Status 502: the answer was no problem+json; is there a proxy between?").wait_for()
    tab.page.unroute("**/readyz")
    refused = BUSY | {"title": "The service cannot do this now", "status": 503}
    tab.page.route("**/readyz", lambda route: route.fulfill(status=503, json=refused))
    checks.get_by_text("The service cannot do this now: try again").wait_for()
    tab.page.unroute("**/readyz")
    checks.get_by_text("Ready", exact=True).wait_for()
    tab.complaints.clear()  # of what was refused


def test_back_leaves_an_open_view_and_the_dialog_before_deleting_it(opened: Open, service: RunningService) -> None:
    enrolled(service, "behind", range(560, 561), place="porch")
    tab = opened("maps")
    tab.page.get_by_role("link", name="behind", exact=True).click()
    tab.page.get_by_label("View 1: porch").click()
    tab.page.get_by_role("button", name="Delete this view").click()
    tab.page.get_by_role("heading", name="Delete this view?").wait_for()
    tab.page.go_back()
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()
    tab.awaits("dialog", 0)
    assert len(views(service, "behind")) == 1


def test_what_is_refused_each_time_it_is_looked_at_is_told_once(opened: Open) -> None:
    tab, refused = opened("service", refusals=True), []

    def refuse(route: "Route") -> None:
        refused.append(route.request.url)
        problem = BUSY | {"title": "The key does not allow this", "status": 403, "request_id": f"r{len(refused)}"}
        route.fulfill(status=403, json=problem, content_type="application/problem+json")

    tab.page.route("**/metrics", refuse)
    tab.page.get_by_text("request r3").last.wait_for()
    listed = tab.page.locator("li").filter(has_text="GET /metrics")
    assert listed.count() == 1
    assert len(refused) >= 3


def test_the_documentation_of_the_api_is_no_wider_than_a_small_phone(opened: Open) -> None:
    tab = opened("ask", size={"width": 320, "height": 640}, refusals=True)  # of the icon, which that page has none of
    tab.page.goto(f"{tab.url}/docs")
    for details in tab.page.locator("details").all():
        details.evaluate("details => (details.open = true)")
    assert not tab.is_wider_than_the_window()


@pytest.mark.parametrize("part", ["health", "inbox"])
def test_a_screen_that_was_left_before_its_answer_came_chooses_no_map(opened: Open, part: str) -> None:
    held: list[Route] = []
    tab = opened("maps")
    before = tab.page.evaluate("sessionStorage.getItem('revisit-map')")
    last = {"health": "**/maps/town/health*", "inbox": "**/maps/town/proposals*"}[part]
    tab.page.route(last, lambda route: held.append(route))
    tab.page.evaluate(f"location.hash = '#maps/town/{part}'")
    while not held:
        tab.page.wait_for_timeout(20)
    tab.page.evaluate("location.hash = '#service'")
    tab.page.locator('main[data-screen="service"]').wait_for()
    with tab.page.expect_response(last):
        held[0].continue_()
    tab.page.wait_for_timeout(100)
    assert tab.page.evaluate("sessionStorage.getItem('revisit-map')") == before
