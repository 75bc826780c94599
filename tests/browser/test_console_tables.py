"""Tables of positions on Enrol: read as the command line and imports read them."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from schemas import values
from schemas.records import ViewAttributes
from tests.browser.conftest import Open
from tests.sample_images import photo as drawn_photo
from worker.service import manifests

if TYPE_CHECKING:
    from playwright.sync_api import Page

ALIKE = {
    "commas": b"file,place,x,y\na.jpg,hall,1,2\n",
    "a mark of UTF-8": "\ufefffile,place,x,y\na.jpg,Säule,1,2\n".encode(),
    "semicolons and decimal commas": "file;place;x;y;heading\r\na.jpg;Höfe, hinten;1,5;-2,25;90\r\n".encode(),
    "tabs": b"file\tplace\tlat\tlon\na.jpg\thall\t50.5\t14.25\n",
    "a line of Excel": b"sep=;\r\nfile;x;y\r\na.jpg;1,5;2\r\n",
    "another line of Excel": b"SEP=,\nfile,x,y\na.jpg,1.5,2\n",
    "other names": b"# Image Name,Latitude,Longitude,Altitude,Bearing\nwalk\\a.jpg,50.5,14.25,200,-10\n",
    "both frames": b"file,x,y,lat,lon,alt\na.jpg,1,2,50,14,200\n",
    "seconds": b"file,x,y,timestamp\na.jpg,1,2,1767225600.5\n",
    "nanoseconds": b"file,x,y,timestamp\na.jpg,1,2,1767225600000000000\n",
    "ends of old": b"file,x,y\ra.jpg,1,2\rb.jpg,3,4\r",
    "columns that a spreadsheet left empty": b"file,x,y,,\na.jpg,1,2,,\n",
    "quotes": b'file,place,x,y\na.jpg,"the ""hall"", below",1,2\n',
}
REFUSED = {
    "Latin-1": ("file,place\na.jpg,Säule\n".encode("latin-1"), "saves it so as “CSV UTF-8”"),
    "UTF-16": ("file,place\na.jpg,hall\n".encode("utf-16"), "saves it so as “CSV UTF-8”"),
    "thousands": (b'file,x,y\na.jpg,"1,234",2\n', "row 1: x is 1,234, which may have a comma for thousands"),
    "one meaning": (b"file,lon,lng,lat\na.jpg,1,2,3\n", "the first line names a column twice: lon"),
    "a date": (b"file,x,y,time\na.jpg,1,2,20260301093000\n", "row 1: captured_at is 20260301093000"),
}


def read(page: "Page", table: bytes) -> dict[str, dict[str, str]]:
    """What the console reads: attributes by file."""
    found: dict[str, dict[str, str]] = page.evaluate(
        """async (bytes) => {
            const { positionsOf } = await import("/console/csv.js");
            return Object.fromEntries(positionsOf(new Uint8Array(bytes)));
        }""",
        list(table),
    )
    return found


def as_known(attributes: ViewAttributes) -> dict[str, Any]:
    known = {**attributes.position.__dict__, "place": attributes.place, "captured_at": attributes.captured_at}
    return {name: value for name, value in known.items() if value is not None}


def test_a_table_says_the_same_in_the_console_as_elsewhere(opened: Open) -> None:
    """Semicolons, decimal commas, other names of columns and Excel's line sep=; were refused here alone."""
    page = opened("enrol").page
    for what, table in ALIKE.items():
        manifest = manifests.read_manifest("t.csv", table)
        expected = {row.file: as_known(manifests.attributes(row, "t.csv")) for row in manifest.rows}
        found = read(page, table)
        assert found.keys() == expected.keys(), what
        for file, row in found.items():
            given: dict[str, Any] = {**row}
            for name in given.keys() & set(manifests.NUMBERS):
                given[name] = float(given[name]) % 360 if name == "heading" else float(given[name])
            if "captured_at" in given:
                given["captured_at"] = values.moment(given["captured_at"])
            assert given == expected[file], what


def test_columns_have_the_same_names_in_the_console_as_elsewhere(opened: Open) -> None:
    names = opened("enrol").page.evaluate("import('/console/csv.js').then(({ NAMES }) => NAMES)")
    assert {ours: tuple(others.split(" ")) for ours, others in names.items()} == manifests.NAMES


def test_a_table_that_is_refused_elsewhere_is_refused_in_the_console(opened: Open, tmp_path: Path) -> None:
    """Of one that is no UTF-8, places were named S\ufffdule, or the columns said to be missing."""
    (tmp_path / "a.jpg").write_bytes(drawn_photo(1))
    tab = opened("enrol")
    tab.page.get_by_label("Choose photos").set_input_files(tmp_path / "a.jpg")
    for what, (table, reason) in REFUSED.items():
        with pytest.raises(ValueError, match=r"t\.csv"):
            _ = [manifests.attributes(row, "t.csv") for row in manifests.read_manifest("t.csv", table).rows]
        (tmp_path / f"{what}.csv").write_bytes(table)
        tab.page.get_by_label("Positions (CSV)").set_input_files(tmp_path / f"{what}.csv")
        tab.page.get_by_role("alert").filter(has_text=f"{what}.csv").filter(has_text=reason).wait_for()
        assert tab.page.get_by_label("Place of a.jpg").input_value() == ""
