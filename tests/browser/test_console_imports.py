"""Recordings and videos are imported in the console."""

import re
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx

from tests.browser.conftest import Open
from tests.browser.test_console_drops import drop, middle
from tests.browser.test_console_maps import check, seen
from tests.browser.test_console_mishaps import JOB
from tests.drawn_videos import frames, video
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Route


def test_a_recording_is_imported_and_each_fault_is_told(opened: Open, service: RunningService, tmp_path: Path) -> None:
    archive = tmp_path / "walk.zip"
    with zipfile.ZipFile(archive, "w") as recording:
        recording.writestr("manifest.csv", "file,place,x,y\n0.jpg,gate,1,2\n1.jpg,yard,far,2\n")
        for number, place in enumerate(("mill lane", "rose garden")):
            recording.writestr(f"{number}.jpg", seen(place))
        recording.writestr("notes.txt", "a fine day")
    (tmp_path / "bad.zip").write_text("no archive")
    tab = opened("enrol", bypass_csp=True, refusals=True)
    tab.page.get_by_label("or a new map").fill("walk")
    panel = tab.page.get_by_label("A recording", exact=True)
    choose, start = (
        panel.get_by_label("Choose a zip archive or a video"),
        panel.get_by_role("button", name="Import the recording"),
    )
    choose.set_input_files(tmp_path / "bad.zip")
    start.press("Enter")
    assert "zip" in panel.get_by_role("alert").inner_text()

    choose.set_input_files(archive)
    start.press("Enter")
    panel.get_by_text("Done: walk.").wait_for()
    assert [(one["place"], one["state"]) for one in httpx.get(f"{service.url}/views?map=walk").json()["views"]] == [
        ("gate", "ready")
    ]
    panel.get_by_text("The row of the manifest cannot be used: 1").wait_for()
    assert "x is 'far', which is no number" in panel.inner_text()
    assert panel.get_by_text("notes.txt").is_visible()
    check(tab, "a recording")


def test_a_proxy_that_answers_in_place_of_the_service_is_told_from_it(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "walk.zip").write_bytes(b"PK")
    tab = opened("enrol", bypass_csp=True, refusals=True)
    tab.page.route("**/imports", lambda route: route.fulfill(body="<h1>Log in</h1>", content_type="text/html"))
    tab.page.get_by_label("or a new map").fill("walk")
    panel = tab.page.get_by_label("A recording", exact=True)
    panel.get_by_label("Choose a zip archive or a video").set_input_files(tmp_path / "walk.zip")
    panel.get_by_role("button", name="Import the recording").press("Enter")

    assert "a proxy between" in panel.get_by_role("alert").inner_text()
    tab.awaits_enabled("Import the recording")


def test_an_import_goes_on_where_the_key_ends_that_began_it(opened: Open, tmp_path: Path) -> None:
    """It was said not to be imported, though it was."""
    (tmp_path / "walk.zip").write_bytes(b"PK")
    refused = {"type": "urn:x:unauthorized", "title": "No key", "status": 401, "detail": "it ended"}
    tab = opened("enrol", refusals=True)
    tab.page.route("**/imports", lambda route: route.fulfill(status=202, json=JOB | {"kind": "import"}))
    tab.page.route("**/jobs/j1", lambda route: route.fulfill(status=401, json=refused))
    panel = tab.page.get_by_label("A recording", exact=True)
    panel.get_by_label("Choose a zip archive or a video").set_input_files(tmp_path / "walk.zip")
    panel.get_by_role("button", name="Import the recording").press("Enter")
    tab.page.locator("#sign-in").wait_for()
    assert "walk.zip was sent; the jobs of the map tell" in panel.inner_text()


def test_a_video_is_imported_with_a_frame_every_two_seconds(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    video(tmp_path / "walk.mp4", frames(6), 1, "mp4v")
    tab = opened("enrol", bypass_csp=True, refusals=True)
    tab.page.get_by_label("or a new map").fill("filmed")
    panel = tab.page.get_by_label("A recording", exact=True)
    panel.get_by_label("Choose a zip archive or a video").set_input_files(tmp_path / "walk.mp4")
    panel.get_by_label("Every").fill("1m")
    panel.get_by_label("Every").press("Enter")
    assert "does not say where" in panel.get_by_role("alert").inner_text()

    panel.get_by_label("Every").fill("2s")
    panel.get_by_label("Every").press("Enter")
    panel.get_by_text("Done: filmed.").wait_for()
    views = httpx.get(f"{service.url}/views?map=filmed").json()["views"]
    assert [view["metadata"]["video_s"] for view in views] == [0, 2, 4]


def test_recordings_that_are_dropped_together_are_imported_one_after_another(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    """One of them was taken, and the others were said to be no images; a bad one does not stop those behind it."""
    dropped = [tmp_path / name for name in ("one.zip", "bad.zip", "two.zip", "photo.jpg")]
    for path, place in ((dropped[0], "mill lane"), (dropped[2], "rose garden")):
        with zipfile.ZipFile(path, "w") as recording:
            recording.writestr(f"{place}.jpg", seen(place))
    dropped[1].write_text("no archive")
    dropped[3].write_bytes(seen("castle park"))
    tab = opened("enrol", refusals=True)
    tab.page.get_by_label("or a new map").fill("walks")
    drop(tab, dropped, *middle(tab, ".drop"))
    tab.page.get_by_role("button", name="Enrol 1 photo").wait_for()
    assert "Left out" not in tab.page.locator("main").inner_text()
    panel = tab.page.get_by_label("A recording", exact=True)
    panel.get_by_role("button", name="Import 3 recordings").press("Enter")
    tab.awaits("text='Done: walks.'", 2)
    assert panel.get_by_role("heading", level=3).all_inner_texts() == ["one.zip", "bad.zip", "two.zip"]
    assert panel.get_by_role("alert").count() == 1
    panel.get_by_text("bad.zip was not imported.").wait_for()
    assert len(httpx.get(f"{service.url}/views?map=walks").json()["views"]) == 2


def test_a_recording_that_comes_while_others_are_imported_is_not_dropped_without_a_word(
    opened: Open, tmp_path: Path
) -> None:
    for name in ("one.zip", "two.zip"):
        (tmp_path / name).write_bytes(b"PK")
    tab = opened("enrol")
    held: list[Route] = []
    tab.page.route("**/imports", lambda route: held.append(route))
    panel = tab.page.get_by_label("A recording", exact=True)
    choose = panel.get_by_label("Choose a zip archive or a video")
    choose.set_input_files(tmp_path / "one.zip")
    panel.get_by_role("button", name="Import the recording").press("Enter")
    choose.set_input_files(tmp_path / "two.zip")
    panel.get_by_role("alert").filter(has_text="two.zip: recordings are being imported").wait_for()
    assert panel.get_by_role("heading", level=3).all_inner_texts() == ["one.zip"]


def test_an_import_is_listed_behind_the_jobs_of_the_views_that_it_enrolled(opened: Open) -> None:
    """There is one for each; after 100 the list said that there was no job, and none could be cancelled."""
    described: list[dict[str, Any]] = [
        JOB | {"id": f"d{number}", "kind": "describe", "state": "done", "progress": None} for number in range(150)
    ]
    jobs = [*described, JOB | {"kind": "import"}]

    def answered(route: "Route") -> None:
        params = httpx.URL(route.request.url).params
        wanted = [job for job in jobs if job["kind"] in params.get("kind", job["kind"]).split(",")]
        route.fulfill(json={"jobs": wanted[: int(params["limit"])], "next": None})

    tab = opened()
    tab.page.route(re.compile(r"/jobs\?"), answered)
    tab.show("maps/town")
    listed = tab.page.get_by_role("region", name="Jobs")
    listed.get_by_text("importing a recording").wait_for()
    assert listed.get_by_role("button", name="Cancel").count() == 1
