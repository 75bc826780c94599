"""The console as a person uses it, in a real browser on a running service."""

import json
import math
import os
import re
import subprocess
import sys
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from app.http.examples import VIEW
from lab.benchmarks import first_answer
from tests.browser.conftest import LAPTOP, PHONE, PLACES, Open, Tab
from tests.sample_images import drawn, encoded, exif_of_a_phone, photo as drawn_photo
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Route, ViewportSize

SCREENS = ("ask", "enrol", "maps", "maps/town", "service")


def ask(tab: Tab, path: Path, map_name: str = "town") -> None:
    tab.page.get_by_label("Map", exact=True).select_option(map_name)
    tab.page.get_by_label("Choose a photo").set_input_files(path)
    tab.page.wait_for_selector(".verdict")


def views(service: RunningService, map_name: str) -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = httpx.get(f"{service.url}/views", params={"map": map_name}).json()["views"]
    return listed


def enrolled(service: RunningService, map_name: str, seeds: range, **fields: str) -> None:
    for seed in seeds:
        data = {"map": map_name, **fields}
        httpx.post(
            f"{service.url}/enroll", files={"image": drawn_photo(seed)}, data=data, timeout=60
        ).raise_for_status()


# ask


def test_a_newcomer_asks_with_a_photo_and_sees_the_place_and_why(opened: Open, query_photo: Path) -> None:
    tab = opened()
    ask(tab, query_photo)

    assert tab.page.locator(".verdict h2").inner_text() == "This is mill lane"
    first = tab.page.locator(".bars li").first
    assert first.locator(".name").inner_text() == "mill lane"
    assert tab.page.get_by_text("nowhere: none of these").is_visible()
    tab.page.wait_for_selector(".match img[src^=blob]")
    assert tab.page.get_by_text(re.compile(r"Taken about")).inner_text().startswith("Taken about x 0.")
    around = f"Plan with {2 * len(PLACES)} positions and where your photo was taken"
    tab.page.get_by_label(around).wait_for()
    tab.page.get_by_text("Everything in one picture").click()
    explanation = tab.page.get_by_alt_text("Explanation of the answer")
    assert explanation.evaluate("image => image.decode().then(() => image.naturalWidth)") == 1600


def test_the_plan_of_an_answer_shows_what_is_around_it_wherever_that_is_in_the_map(
    opened: Open, query_photo: Path
) -> None:
    tab = opened()
    with tab.page.expect_request(re.compile("/views[?].*near=")) as sent:
        ask(tab, query_photo)
    x, y, radius = map(float, httpx.URL(sent.value.url).params["near"].split(","))
    assert (x, y) == pytest.approx(PLACES["mill lane"], abs=2)
    assert radius >= 2 * max(math.hypot(x - east, y - north) for east, north in PLACES.values())


def test_pointing_at_a_region_joins_it_in_both_photos_and_says_how_alike(opened: Open, query_photo: Path) -> None:
    tab = opened()
    ask(tab, query_photo)
    chip = tab.page.locator(".chips button").first
    chip.focus()
    label, similarity = chip.inner_text().rsplit(" ", 1)
    assert tab.page.locator(".pairs .point.lit").count() == 2
    assert tab.page.get_by_text(f"{label}: similarity {similarity}").is_visible()


def test_a_photo_is_dropped_or_pasted(opened: Open, query_photo: Path) -> None:
    tab = opened()
    tab.page.get_by_label("Map", exact=True).select_option("town")
    for event, field in (("drop", "dataTransfer"), ("paste", "clipboardData")):
        tab.page.evaluate(
            """async ([event, field, bytes]) => {
                const data = new DataTransfer();
                data.items.add(new File([new Uint8Array(bytes)], `by-${event}.jpg`, { type: "image/jpeg" }));
                const sent = event === "drop" ? new DragEvent(event, { [field]: data, bubbles: true })
                                              : new ClipboardEvent(event, { [field]: data, bubbles: true });
                document.querySelector(".drop").dispatchEvent(sent);
            }""",
            [event, field, list(query_photo.read_bytes())],
        )
        tab.page.get_by_alt_text(f"Your photo, by-{event}.jpg").wait_for()
        tab.page.wait_for_selector(".verdict.matched")


def test_the_copied_calls_give_the_same_answer(opened: Open, query_photo: Path) -> None:
    tab = opened()
    tab.page.get_by_text("Filters and more").click()
    tab.page.get_by_label("Matches at most").fill("2")
    tab.page.get_by_label("Zoom against the map's camera").fill("1.05")
    tab.page.get_by_label("Turned clockwise, degrees").fill("-1.5")
    tab.page.get_by_label("Near x,y,radius").fill("0,0,70")
    ask(tab, query_photo)
    tab.page.get_by_text("The same from a program").click()

    told = tab.page.get_by_label("As Python").inner_text()
    done = subprocess.run(
        [sys.executable, "-c", told], cwd=query_photo.parent, env=dict(os.environ), capture_output=True, text=True
    )
    assert done.stdout.startswith("matched "), done.stderr
    curl = tab.page.get_by_label("As curl").inner_text()
    assert [part.strip(" \\") for part in curl.splitlines()] == [
        "curl -F 'image=@\"today.jpg\"'",
        "--form-string 'map=town'",
        "--form-string 'explain=true'",
        "--form-string 'top=2'",
        "--form-string 'zoom=1.05'",
        "--form-string 'roll=-1.5'",
        "--form-string 'near=0,0,70'",
        f"{tab.url}/query",
    ]
    answer = subprocess.run(["sh", "-c", curl], cwd=query_photo.parent, capture_output=True, text=True)
    assert json.loads(answer.stdout)["status"] == "matched", answer.stderr


def test_photos_of_a_drive_count_together_and_the_copied_calls_name_it(opened: Open, query_photo: Path) -> None:
    tab = opened(bypass_csp=True, refusals=True)
    tab.page.get_by_text("Photos of one drive").press("Enter")
    tab.page.get_by_label("Name of the drive").fill("round 1")
    tab.page.get_by_label("Choose a photo").set_input_files(query_photo)
    assert "drive" in tab.page.get_by_role("alert").locator("code").first.inner_text()

    tab.page.get_by_label("Name of the drive").fill("round-1")
    tab.page.get_by_label("Forgotten after, seconds").fill("90")
    ask(tab, query_photo)
    drive = tab.page.get_by_label("The drive", exact=True)
    drive.get_by_text("This is its first image. This one alone: recognised.").wait_for()
    tab.page.get_by_role("button", name="Ask", exact=True).click()
    drive.get_by_text("2 images count together.").wait_for()
    assert drive.locator(".bars .name").first.inner_text() == "mill lane"
    assert drive.get_by_text("nowhere: none of these").is_visible()
    tab.page.get_by_text("The same from a program").click()
    assert "--form-string 'drive_timeout=90'" in tab.page.get_by_label("As curl").inner_text()
    assert 'drive="round-1", drive_timeout=90' in tab.page.get_by_label("As Python").inner_text()
    tab.page.evaluate((resources.files("axe_playwright_python") / "axe.min.js").read_text())
    assert tab.page.evaluate("axe.run().then((found) => found.violations.map((one) => one.id))") == []


def test_a_refused_query_says_what_was_wrong(opened: Open, tmp_path: Path) -> None:
    bad = tmp_path / "note.jpg"
    bad.write_text("no image")
    tab = opened(refusals=True)
    tab.page.get_by_label("Choose a photo").set_input_files(bad)
    assert "This is not an image" in tab.page.get_by_role("alert").inner_text()
    tab.show("service")
    tab.page.locator("section", has_text="Problems in this tab").get_by_text("POST /query: 415").wait_for()


# enrol


def test_of_several_photos_one_is_bad_and_the_others_are_enrolled_with_their_positions(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    photos = [tmp_path / f"{number}.jpg" for number in range(3)]
    for number, path in enumerate(photos):
        path.write_bytes(drawn_photo(200 + number))
    photos[2].write_bytes(encoded(drawn(96, 64) // 16))
    (tmp_path / "bad.jpg").write_text("no image")
    table = tmp_path / "positions.csv"
    table.write_text('file,place,x,y,heading\n0.jpg,"gate, north",1.5,-2,90\nphotos/1.jpg,,3,4,\n')
    tab = opened("enrol", refusals=True)

    tab.page.get_by_label("or a new map").fill("yard")
    tab.page.get_by_label("Place", exact=True).fill("yard")
    tab.page.get_by_label("Choose photos").set_input_files([*photos, tmp_path / "bad.jpg"])
    tab.page.get_by_label("Positions (CSV)").set_input_files(table)
    tab.page.get_by_label("Position of 2.jpg").fill("7; 8")
    tab.page.get_by_role("button", name="Enrol 4 photos").click()
    tab.page.locator("main").get_by_text("4 of 4 photos done, 1 refused.").wait_for()

    refused = tab.page.locator(".files .refused").all_inner_texts()
    assert len(refused) == 1
    assert refused[0].startswith("This is not an image")
    assert "the image is dark" in tab.page.locator(".files .done").all_inner_texts()[2]
    found = {(one["place"], one["position"]["x"], one["position"]["y"]) for one in views(service, "yard")}
    assert found == {("gate, north", 1.5, -2.0), ("yard", 3.0, 4.0), ("yard", 7.0, 8.0)}
    tab.awaits_enabled("Try again: enrol 1 photo")


def test_ten_photos_of_a_newcomer_give_a_sure_answer(
    chromium: "Browser", service: RunningService, tmp_path: Path
) -> None:
    photos, queries = first_answer.drawn(tmp_path)
    *before, last = first_answer.walk(chromium, service.url, photos, queries)
    assert [step.name for step in before[:2]] == ["the console opens", "10 photos are enrolled"]
    assert last.seen == f"This is {photos[queries.index(tmp_path / 'asked' / last.name)].stem}"


def test_photos_say_themselves_where_they_were_taken(opened: Open, service: RunningService, tmp_path: Path) -> None:
    (tmp_path / "phone.jpg").write_bytes(encoded(drawn(96, 64, 230), "jpeg", exif=exif_of_a_phone()))
    tab = opened("enrol")
    tab.page.get_by_label("or a new map").fill("phone")
    tab.page.get_by_label("Choose photos").set_input_files([tmp_path / "phone.jpg"])
    tab.page.get_by_label("Position and time from the photos (EXIF)").check()
    tab.page.get_by_role("button", name="Enrol 1 photo").click()
    tab.page.locator(".files .done").get_by_text("enrolled at -27.400000, 153.000000").wait_for()
    [view] = views(service, "phone")
    assert (view["position"]["lat"], view["position"]["heading"]) == (pytest.approx(-27.4), 90)


def test_a_photo_is_placed_by_a_click_on_the_plan(opened: Open, service: RunningService, tmp_path: Path) -> None:
    photos = [tmp_path / "first.jpg", tmp_path / "second.jpg"]
    for number, path in enumerate(photos):
        path.write_bytes(drawn_photo(210 + number))
    tab = opened("enrol")
    tab.page.get_by_label("Map", exact=True).select_option("town")
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    tab.page.get_by_text("Set positions on the plan").click()
    tab.page.get_by_text("Click where this was taken: first.jpg").wait_for()
    plan = tab.page.locator("canvas.plan")
    tab.page.get_by_label(f"Plan with {2 * len(PLACES)} positions").wait_for()
    plan.click()
    tab.page.get_by_text("Click where this was taken: second.jpg").wait_for()
    x, y = map(float, tab.page.get_by_label("Position of first.jpg").input_value().split(","))
    wide, high = [(min(axis), max(axis)) for axis in zip(*PLACES.values(), strict=True)]
    assert (x, y) == pytest.approx((sum(wide) / 2 + 0.5, sum(high) / 2), abs=1)

    tab.page.get_by_label("Position of first.jpg").fill(f"{x}, {y}, 45")
    box = plan.bounding_box()
    assert box is not None
    plan.click(position={"x": box["width"] / 2, "y": 28})  # the margin above the northernmost view
    x, y, heading = map(float, tab.page.get_by_label("Position of first.jpg").input_value().split(","))
    assert y == pytest.approx(high[1], abs=1)
    assert heading == 45


# maps


def test_a_view_is_renamed_and_deleted_with_the_keyboard(opened: Open, service: RunningService) -> None:
    enrolled(service, "shed", range(300, 303), place="shed")
    tab = opened("maps/shed")
    tab.page.locator(".grid .cell button").first.focus()
    tab.page.keyboard.press("Enter")
    tab.page.get_by_text("Edit", exact=True).press("Enter")
    dialog = tab.page.get_by_role("dialog")
    dialog.get_by_label("Place").fill("old shed")
    dialog.get_by_label("x, metres").fill("2.5")
    dialog.get_by_label("y, metres").fill("4")
    dialog.get_by_label("Place").press("Enter")
    dialog.wait_for(state="detached")
    changed = views(service, "shed")[0]
    assert (changed["place"], changed["position"]["x"], changed["position"]["y"]) == ("old shed", 2.5, 4)

    tab.page.get_by_label("View 1: old shed").press("Enter")
    tab.page.get_by_role("button", name="Delete this view …").press("Enter")
    tab.page.get_by_role("button", name="Cancel").press("Enter")
    assert len(views(service, "shed")) == 3
    tab.page.get_by_role("button", name="Delete this view …").press("Enter")
    tab.confirm("Delete the view")
    tab.page.locator("dialog.receipt").get_by_text("Nothing of it is left here").wait_for()
    tab.page.locator("dialog.receipt button").press("Enter")
    tab.page.get_by_label("View 1: old shed").wait_for(state="detached")
    assert [one["place"] for one in views(service, "shed")] == ["shed", "shed"]


def test_a_map_is_made_and_deleted_only_once_its_name_is_typed(opened: Open, service: RunningService) -> None:
    tab = opened("maps")
    tab.page.get_by_text("New map").click()
    tab.page.get_by_label("Name").fill("attic")
    tab.page.get_by_label("Labels, with commas").fill("wall, floor, person")
    tab.page.get_by_label("Those that move").fill("person")
    tab.page.get_by_role("button", name="Make the map").click()
    tab.page.get_by_role("heading", name="attic").wait_for()
    labels = httpx.get(f"{service.url}/maps/attic").json()["labels"]
    assert [(one["label"], one["dynamic"]) for one in labels] == [("wall", False), ("floor", False), ("person", True)]

    tab.page.get_by_role("button", name="Delete this map …").click()
    assert tab.page.get_by_role("button", name="Delete the map").is_disabled()
    tab.page.get_by_label("To go on, type attic").fill("attic")
    tab.confirm("Delete the map")
    tab.page.locator("dialog.receipt").get_by_role("button", name="Close").click()
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()
    assert httpx.get(f"{service.url}/maps/attic").status_code == 404


def test_the_views_of_a_place_are_shown_alone(opened: Open) -> None:
    tab = opened("maps/town")
    tab.awaits(".grid .cell", 2 * len(PLACES))
    tab.page.get_by_role("button", name=re.compile("^rose garden")).click()
    tab.page.get_by_role("heading", name="rose garden").wait_for()
    tab.awaits(".grid .cell", 2)


def test_a_name_is_shown_as_text_whatever_it_contains(opened: Open, service: RunningService) -> None:
    hostile = "<img src=x onerror=alert(1)><b>gate</b>"
    enrolled(service, "odd", range(400, 401), place=hostile)
    tab = opened("maps/odd")
    assert tab.page.locator(".names span").first.inner_text() == hostile
    assert tab.page.locator("main b, main img[src=x]").count() == 0


def test_a_map_of_ten_thousand_views_scrolls(opened: Open) -> None:
    """The service's answers are made up here, in its own shape."""
    total, read = 10_000, []

    def answered(route: "Route") -> None:
        url = httpx.URL(route.request.url)
        if url.path == "/views":
            begin, limit = int(url.params.get("cursor", "0")), int(url.params["limit"])
            read.append(begin)
            rows = [VIEW | {"id": f"v{row:05}", "place": f"place {row}"} for row in range(begin, begin + limit)]
            after = begin + limit
            route.fulfill(json={"views": rows, "next": str(after) if after < total else None})
        elif url.path == "/places":
            route.fulfill(json={"places": [], "next": None})
        elif url.path.endswith("/thumbnail"):
            route.fulfill(body=thumbnail, content_type="image/jpeg")
        else:
            facts = route.fetch().json()
            route.fulfill(json=facts | {"views": {"ready": total}, "places": total, "extent": None})

    thumbnail = drawn_photo(1)
    tab = opened("service")
    tab.page.route(re.compile(r"/views|/places|/maps/town$"), answered)
    tab.show("maps/town")
    grid = tab.page.get_by_role("region", name="Thumbnails of views")
    tab.page.get_by_label("View 1: place 0", exact=True).wait_for()
    assert len(read) == 1

    began = datetime.now(UTC)
    grid.evaluate("grid => { grid.scrollTop = grid.scrollHeight }")
    tab.page.get_by_label("View 10000: place 9999").wait_for()
    took = (datetime.now(UTC) - began).total_seconds()

    assert len(read) == len(set(read)) == 20
    assert took < 10
    assert tab.page.locator(".grid .cell").count() < 200
    grid.evaluate("grid => { grid.scrollTop = grid.scrollHeight / 2 }")
    tab.page.get_by_label("View 5000: place 4999").wait_for()
    tab.page.locator(".grid img[src^=blob]").first.wait_for()


# everybody


def test_light_or_dark_is_chosen_and_remembered(opened: Open) -> None:
    tab = opened(color_scheme="light")
    ground = "getComputedStyle(document.body).backgroundColor"
    light = tab.page.evaluate(ground)
    for _ in range(2):  # auto, light, dark
        tab.page.get_by_role("button", name="Colours").click()
    assert tab.page.evaluate(ground) != light
    tab.page.reload()
    assert tab.page.evaluate(ground) != light


@pytest.mark.parametrize(("theme", "size"), [("light", LAPTOP), ("dark", PHONE)], ids=["light laptop", "dark phone"])
def test_every_screen_passes_axe_and_fits_its_window(
    opened: Open, query_photo: Path, theme: str, size: "ViewportSize"
) -> None:
    axe = (resources.files("axe_playwright_python") / "axe.min.js").read_text()
    # Drawings that the service is too busy for are asked for again.
    tab = opened(size=size, color_scheme=theme, bypass_csp=True, refusals=True)

    def check(name: str) -> None:
        tab.page.evaluate(axe)
        found = tab.page.evaluate("axe.run().then((found) => found.violations)")
        named = [f"{one['id']}: {node['html']}" for one in found for node in one["nodes"]]
        assert named == [], name
        assert not tab.is_wider_than_the_window(), name

    for screen in SCREENS:
        tab.show(screen)
        check(screen)
    tab.show("maps/town")
    tab.page.locator(".grid .cell button").first.click()
    tab.page.wait_for_selector("dialog img[src^=blob]")
    tab.page.get_by_text("Edit", exact=True).click()
    check("a view")
    tab.page.get_by_role("button", name="Close").click()
    tab.show("ask")
    ask(tab, query_photo)
    for summary in tab.page.locator("summary").all():
        summary.click()
    tab.page.get_by_alt_text("Context graph of the view").wait_for()
    check("an answer")
