"""Manifests as people and programs write them."""

import time
import unicodedata
from datetime import UTC, datetime

import pytest

from schemas.records import Position
from worker.service.manifests import attributes, read_manifest


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_quoted_value_keeps_its_lines(end: str) -> None:
    text = f'file,place,note{end}a.jpg,hall,"two{end}lines"{end}b.jpg,roof,{end}'

    manifest = read_manifest("manifest.csv", text.encode())

    assert [attributes(row, "manifest.csv").place for row in manifest.rows] == ["hall", "roof"]
    assert attributes(manifest.rows[0], "manifest.csv").metadata == {"note": f"two{end}lines"}


@pytest.mark.parametrize("text", ["a\u2028b", "a\u0085b", "a\x0bb", "a\x1cb"])
def test_what_only_python_takes_for_the_end_of_a_line_is_text(text: str) -> None:
    table = read_manifest("manifest.csv", f"file,note\na.jpg,{text}\n".encode())
    assert [dict(row.further) for row in table.rows] == [{"note": text}]
    if text > "a ":  # JSON has control characters as escapes alone
        lines = read_manifest("manifest.ndjson", f'{{"file": "a.jpg", "note": "{text}"}}\n'.encode())
        assert [dict(row.further) for row in lines.rows] == [{"note": text}]


@pytest.mark.parametrize("row", ['a.jpg,"hall\nb.jpg,roof\nc.jpg,cellar\n', 'a.jpg,"hall'])
def test_a_quote_that_is_not_closed_swallows_no_rows(row: str) -> None:
    with pytest.raises(ValueError, match=r"manifest\.csv, line \d: a quoted value .* is not closed"):
        read_manifest("manifest.csv", f"file,place\n{row}".encode())


@pytest.mark.parametrize("row", ['a.jpg,"hall" ', 'a.jpg,5"', 'a.jpg,"5"""', '"a.jpg","hall"'])
def test_other_quotes_are_read_as_before(row: str) -> None:
    assert len(read_manifest("manifest.csv", f"file,place\n{row}\n".encode()).rows) == 1


@pytest.mark.parametrize("place", ['{"name": "hall"}', '["hall"]', "true"])
def test_a_place_is_text(place: str) -> None:
    (row,) = read_manifest("manifest.ndjson", f'{{"file": "a.jpg", "place": {place}}}'.encode()).rows
    with pytest.raises(ValueError, match=r"place is .* no text"):
        attributes(row, "manifest.ndjson")


def test_a_place_may_be_a_number() -> None:
    (row,) = read_manifest("manifest.ndjson", b'{"file": "a.jpg", "place": 12}').rows
    assert attributes(row, "manifest.ndjson").place == "12"


@pytest.mark.parametrize("column", ["x", "y", "z", "alt"])
def test_a_position_lies_where_distances_can_be_told(column: str) -> None:
    others = {"x": "y", "y": "x", "z": "x,y", "alt": "lat,lon"}[column]
    text = f"file,{column},{others}\na.jpg,1e10{',1' * (others.count(',') + 1)}\n"
    (row,) = read_manifest("manifest.csv", text.encode()).rows
    with pytest.raises(ValueError, match=f"line 2: {column} is 1e[+]10; it needs to be between .* metres"):
        attributes(row, "manifest.csv")


def test_what_is_metadata_says_nothing_of_the_view() -> None:
    """Of another program's record of an image, its own x and place among others."""
    line = b'{"file": "a.jpg", "lat": 1, "lon": 2, "metadata": {"x": 3, "y": 4, "place": "crate", "time": "noon"}}'
    (row,) = read_manifest("manifest.ndjson", line).rows

    known = attributes(row, "manifest.ndjson")

    assert (known.position, known.place, known.captured_at) == (Position(lat=1, lon=2), None, None)
    assert known.metadata == {"x": 3, "y": 4, "place": "crate", "time": "noon"}


@pytest.mark.parametrize("written", ["20260301093000", "20260301093000123", "99999999999", "202603010930"])
def test_a_date_without_signs_is_no_unix_time(written: str) -> None:
    """It would be the year 2612, or without its seconds 1976."""
    (row,) = read_manifest("manifest.csv", f"file,time\na.jpg,{written}\n".encode()).rows
    with pytest.raises(ValueError, match=f"captured_at is {written}, which is no Unix time of today"):
        attributes(row, "manifest.csv")


@pytest.mark.parametrize("digits", [0, 3, 6, 9])
def test_unix_time_is_read_by_its_digits(digits: int) -> None:
    (row,) = read_manifest("manifest.csv", f"file,time\na.jpg,{1_767_225_600 * 10**digits}\n".encode()).rows
    assert attributes(row, "manifest.csv").captured_at == datetime(2026, 1, 1, tzinfo=UTC)


def test_accents_are_the_same_however_a_system_writes_them() -> None:
    """macOS writes a letter and its accent, most others one character."""
    one, two = "Höfe/Straße é.jpg", unicodedata.normalize("NFD", "Höfe/Straße é.jpg")
    assert one != two
    for listed, stored in ((one, two), (two, one)):
        manifest = read_manifest("manifest.csv", f"file,x,y\n{listed},1,2\n".encode())
        assert manifest.of(f"walk/{stored}") is not None
        assert manifest.unused() == []


def test_columns_that_a_spreadsheet_left_empty_are_none() -> None:
    manifest = read_manifest("manifest.csv", b"file,x,y,,\na.jpg,1,2,,\nb.jpg,3,4\nc.jpg,5,6,,,\n")
    assert [dict(row.given) for row in manifest.rows] == [{"x": f"{n}", "y": f"{n + 1}"} for n in (1, 3, 5)]
    assert [dict(row.further) for row in manifest.rows] == [{}] * 3
    assert manifest.columns == ["file", "x", "y"]
    with pytest.raises(ValueError, match="line 2: 5 values, and the first line names 4 columns"):
        read_manifest("manifest.csv", b"file,x,y,,\na.jpg,1,2,,5\n")


@pytest.mark.parametrize("line", ["sep=;\r\n", "\nSEP=; \n", "sep=|\n", "sep=\t\n"])
def test_the_line_in_which_excel_says_what_separates_is_no_row(line: str) -> None:
    """It was said to lack the column `file`."""
    separator = line.strip(" \r\n")[4]
    text = line + separator.join(["file", "x", "y"]) + "\n" + separator.join(["a.jpg", "1,5", "2"]) + "\n"
    (row,) = read_manifest("manifest.csv", text.encode()).rows
    assert attributes(row, "manifest.csv").position == Position(x=1.5, y=2)
    assert row.line == text.count("\n")


def test_a_comma_that_may_be_either_is_not_guessed_at() -> None:
    """Spreadsheets in English put commas before thousands, and then quotes around numbers."""
    with pytest.raises(ValueError, match="line 2: y is '1,234', which may have a comma for thousands or for decimals"):
        read_manifest("manifest.csv", b'file,x,y\na.jpg,1,"1,234"\n')
    for text in (b"file;x;y\na.jpg;0,5;1,234\n", b'file,x,y\na.jpg,"0,500","1,2340"\n'):
        (row,) = read_manifest("manifest.csv", text).rows
        assert attributes(row, "manifest.csv").position == Position(x=0.5, y=1.234)
    (row,) = read_manifest("manifest.csv", b'file,lat,lon\na.jpg,"50,123","14,456"\n').rows
    assert attributes(row, "manifest.csv").position == Position(lat=50.123, lon=14.456)


def test_what_python_alone_takes_for_a_number_is_none() -> None:
    (row,) = read_manifest("manifest.csv", b"file,x,y\na.jpg,12_5,1\n").rows
    with pytest.raises(ValueError, match="line 2: x is '12_5', which is no number"):
        attributes(row, "manifest.csv")


@pytest.mark.parametrize("name", ["manifest.csv", "manifest.ndjson"])
def test_a_row_names_no_file_that_fills_a_report(name: str) -> None:
    begin, end = ("file,x\n", ",1\n") if name.endswith("csv") else ('{"file": "', '"}\n')
    with pytest.raises(ValueError, match=r"line [12]: names a file of 2,000 letters; at most 1,024 are taken"):
        read_manifest(name, f"{begin}{'a' * 2000}{end}".encode())


def test_a_heading_of_next_to_nothing_below_0_is_0() -> None:
    (row,) = read_manifest("manifest.csv", b"file,heading\na.jpg,-1e-17\n").rows
    assert attributes(row, "manifest.csv").position.heading == 0


@pytest.mark.parametrize("separator", [",", ",c"])
def test_a_line_of_very_many_columns_takes_no_longer_than_its_length(separator: str) -> None:
    header = "file" + "".join(f"{separator}{n}" if separator != "," else separator for n in range(300_000))
    began = time.process_time()
    assert len(read_manifest("manifest.csv", f"{header}\na.jpg\n".encode()).rows) == 1
    assert time.process_time() - began < 10
