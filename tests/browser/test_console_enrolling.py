"""What is typed on Enrol, and what a table of positions says: neither takes the other's place unasked."""

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.browser.conftest import Open
from tests.browser.test_console import views
from tests.sample_images import photo as drawn_photo
from tests.stories.running import RunningService

if TYPE_CHECKING:
    from playwright.sync_api import Route


@pytest.fixture
def photos(tmp_path: Path) -> list[Path]:
    """Three photos."""
    paths = [tmp_path / f"{number}.jpg" for number in range(3)]
    for number, path in enumerate(paths):
        path.write_bytes(drawn_photo(700 + number))
    return paths


def test_a_position_that_cannot_be_read_is_told_at_once_and_the_others_are_enrolled(
    opened: Open, service: RunningService, photos: list[Path]
) -> None:
    tab = opened("enrol")
    tab.page.get_by_label("or a new map").fill("typed")
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    tab.page.get_by_label("Position of 1.jpg").fill("12")
    tab.page.get_by_role("button", name="Enrol 3 photos").click()
    tab.page.locator("main").get_by_text("3 of 3 photos done, 1 refused.").wait_for()
    [refused] = tab.page.locator(".files .refused").all_inner_texts()
    assert refused == "Position: two numbers are needed and perhaps a heading, as in 12.5, 3.0, 90; not 12"
    assert len(views(service, "typed")) == 2


def test_photos_that_come_later_leave_what_was_typed_since_the_table(
    opened: Open, photos: list[Path], tmp_path: Path
) -> None:
    table = tmp_path / "positions.csv"
    table.write_text("file,place,x,y\n0.jpg,cellar,1,2\n1.jpg,attic,3,4\n2.jpg,yard,5,6\n")
    tab = opened("enrol")
    tab.page.get_by_label("Choose photos").set_input_files([*photos[:2]])
    tab.page.get_by_label("Positions (CSV)").set_input_files(table)
    tab.page.get_by_text("The CSV file has 3 rows; 2 of 2 photos have one.").wait_for()
    tab.page.get_by_label("Place of 0.jpg").fill("wine cellar")
    tab.page.get_by_label("Position of 0.jpg").fill("1.5, 2.5")

    tab.page.get_by_label("Choose photos").set_input_files(photos[2])
    tab.page.get_by_text("The CSV file has 3 rows; 1 of 1 photo have one.").wait_for()
    assert tab.page.get_by_label("Place of 2.jpg").input_value() == "yard"
    assert tab.page.get_by_label("Place of 0.jpg").input_value() == "wine cellar"
    assert tab.page.get_by_label("Position of 0.jpg").input_value() == "1.5, 2.5"


def test_a_cleared_list_forgets_its_table(opened: Open, photos: list[Path], tmp_path: Path) -> None:
    table = tmp_path / "positions.csv"
    table.write_text("file,place\n0.jpg,cellar\n")
    tab = opened("enrol")
    tab.page.get_by_label("Choose photos").set_input_files(photos[0])
    tab.page.get_by_label("Positions (CSV)").set_input_files(table)
    tab.page.get_by_text("1 of 1 photo have one.").wait_for()
    tab.page.get_by_role("button", name="Clear the list").click()
    assert tab.page.get_by_text("The CSV file has").count() == 0

    tab.page.get_by_label("Choose photos").set_input_files(photos[0])
    assert tab.page.get_by_label("Place of 0.jpg").input_value() == ""
    tab.shows_its_images()


ASKS = "() => !window.dispatchEvent(new Event('beforeunload', { cancelable: true }))"
"""Whether the browser asks before the tab is closed."""


def test_a_tab_that_enrols_is_not_closed_without_a_word(opened: Open, photos: list[Path]) -> None:
    held: list[Route] = []
    tab = opened("enrol")
    tab.page.route("**/enroll", lambda route: held.append(route))
    tab.page.get_by_label("or a new map").fill("closing")
    tab.page.get_by_label("Choose photos").set_input_files(photos[0])
    assert not tab.page.evaluate(ASKS)
    tab.page.get_by_role("button", name="Enrol 1 photo").click()
    tab.page.get_by_text("sending …").wait_for()
    assert tab.page.evaluate(ASKS)
    while not held:
        tab.page.wait_for_timeout(20)
    held[0].continue_()
    tab.page.locator("main").get_by_text("1 of 1 photo done.").wait_for()
    assert not tab.page.evaluate(ASKS)


@pytest.mark.parametrize(
    ("screen", "label"), [("enrol", "or a new map"), ("maps", "Name"), ("snapshots", "Under another name")]
)
def test_a_name_that_no_map_can_have_is_refused_with_what_it_may_be(opened: Open, screen: str, label: str) -> None:
    tab = opened(screen)
    for details in tab.page.locator("main details").all():
        details.evaluate("details => (details.open = true)")
    name = tab.page.get_by_label(label, exact=True)
    name.fill("my house")
    assert name.evaluate("input => input.validity.patternMismatch")
    assert "no spaces" in (name.get_attribute("title") or "")


def test_nothing_can_be_typed_about_a_photo_once_it_is_sent(opened: Open, photos: list[Path]) -> None:
    tab = opened("enrol")
    held: list[Route] = []
    tab.page.route("**/enroll", lambda route: held.append(route))
    tab.page.get_by_label("or a new map").fill("shed")
    tab.page.get_by_label("Place", exact=True).fill("the shed")
    tab.page.get_by_label("Choose photos").set_input_files(photos[0])
    tab.page.get_by_role("button", name="Enrol 1 photo").click()
    tab.page.get_by_text("sending …").wait_for()
    sent = tab.page.get_by_label("Place of 0.jpg")
    assert sent.evaluate("input => input.readOnly")
    while not held:
        tab.page.wait_for_timeout(20)
    held[0].continue_()
    tab.page.locator("main").get_by_text("1 of 1 photo done.").wait_for()
    assert sent.evaluate("input => [input.readOnly, input.value]") == [True, "the shed"]


def test_refused_photos_come_first_and_the_field_that_is_typed_in_keeps_the_focus(
    opened: Open, photos: list[Path], tmp_path: Path
) -> None:
    (tmp_path / "note.jpg").write_text("no image")
    tab = opened("enrol", refusals=True)
    tab.page.get_by_label("or a new map").fill("barn")
    tab.page.get_by_label("Choose photos").set_input_files([*photos, tmp_path / "note.jpg"])
    tab.page.get_by_label("Place of 0.jpg").focus()
    tab.page.get_by_role("button", name="Enrol").evaluate("button => button.form.requestSubmit()")
    tab.page.locator("main").get_by_text("4 of 4 photos done, 1 refused.").wait_for()
    assert tab.page.locator(".files .name").first.inner_text() == "note.jpg"
    assert tab.page.evaluate("document.activeElement.ariaLabel") == "Place of 0.jpg"


def test_on_a_full_disk_the_other_photos_are_not_sent_and_wait_until_there_is_room(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    photos = [tmp_path / f"{number}.jpg" for number in range(5)]
    for number, path in enumerate(photos):
        path.write_bytes(drawn_photo(900 + number))
    sent: list[str] = []
    full = {"title": "The disk is full", "status": 507, "code": "disk-full", "detail": "2 MB are free"}

    def refuse(route: "Route") -> None:
        sent.append(route.request.url)
        route.fulfill(status=507, json=full, content_type="application/problem+json")

    tab = opened("enrol")
    tab.page.route("**/enroll", refuse)
    tab.page.get_by_label("or a new map").fill("full")
    tab.page.get_by_label("Choose photos").set_input_files(photos)
    tab.page.get_by_role("button", name="Enrol 5 photos").click()
    tab.page.get_by_role("alert").get_by_text("2 MB are free").wait_for()
    tab.page.get_by_role("button", name="Enrol 5 photos").wait_for()
    assert 1 <= len(sent) <= 2  # as many as are sent at once
    assert tab.page.locator(".files .waiting").count() == 5 - len(sent)

    tab.complaints.clear()  # of the full disk
    tab.page.unroute("**/enroll")
    tab.page.get_by_role("button", name="Enrol 5 photos").click()
    tab.awaits(".files .done", 5)
    assert len(views(service, "full")) == 5
