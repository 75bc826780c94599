"""Files that are dragged from the desktop onto the console, by the browser's own drag and drop."""

from pathlib import Path

import pytest

from tests.browser.conftest import Open, Tab
from tests.sample_images import photo as drawn_photo


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Photos in a folder, one of them a level deeper."""
    trip = tmp_path / "trip"
    (trip / "monday").mkdir(parents=True)
    for number, name in enumerate(("b.jpg", "a.jpg", "monday/c.jpg")):
        (trip / name).write_bytes(drawn_photo(800 + number))
    return trip


def middle(tab: Tab, selector: str) -> tuple[float, float]:
    """The point in the middle of an element."""
    box = tab.page.locator(selector).bounding_box()
    assert box
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def drop(tab: Tab, paths: list[Path], x: float, y: float) -> None:
    """Drag files or folders over a point of the page, and let them go there."""
    session = tab.page.context.new_cdp_session(tab.page)
    dragged = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        session.send("Input.dispatchDragEvent", {"type": kind, "x": x, "y": y, "data": dragged})


def test_a_file_that_is_dropped_beside_its_place_is_not_opened_instead_of_the_page(opened: Open) -> None:
    """A browser with a window would do that, and all that was typed and chosen be gone; text goes into fields."""
    tab = opened("enrol")
    held = """(kind) => {
        const data = new DataTransfer();
        kind === "file" ? data.items.add(new File(["x"], "a.jpg")) : data.setData("text/plain", "porch");
        const all = ["dragover", "drop"].map(
            (name) => new DragEvent(name, { dataTransfer: data, bubbles: true, cancelable: true }),
        );
        return all.map((event) => !document.querySelector("h1").dispatchEvent(event));
    }"""
    assert tab.page.evaluate(held, "file") == [True, True]
    assert tab.page.evaluate(held, "text") == [False, False]


def test_a_folder_that_is_dropped_is_opened(opened: Open, folder: Path) -> None:
    tab = opened("enrol")
    drop(tab, [folder], *middle(tab, ".drop"))
    tab.page.get_by_role("button", name="Enrol 3 photos").wait_for()
    assert tab.page.locator(".files .name").all_inner_texts() == ["trip/a.jpg", "trip/b.jpg", "trip/monday/c.jpg"]
    assert "Left out" not in tab.page.locator("main").inner_text()


def test_of_several_photos_that_are_dropped_on_ask_the_first_is_sent_and_that_is_said(
    opened: Open, folder: Path
) -> None:
    tab = opened("ask")
    drop(tab, [folder / "b.jpg", folder / "a.jpg"], *middle(tab, ".drop"))
    tab.page.get_by_text("The first of 2 files: one photo is asked at a time.").wait_for()
    tab.page.get_by_alt_text("Your photo, b.jpg").wait_for()
    drop(tab, [folder / "a.jpg"], *middle(tab, ".drop"))
    tab.page.get_by_alt_text("Your photo, a.jpg").wait_for()
    assert "The first of" not in tab.page.locator("main").inner_text()
