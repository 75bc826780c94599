"""Manifests as people and programs write them."""

import pytest

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
