"""Manifests: what is known of the images of a recording, as CSV (commas, semicolons or tabs) or as lines of JSON."""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from schemas import values
from schemas.records import Position, ViewAttributes

NAMES: Mapping[str, tuple[str, ...]] = {
    "file": ("filename", "file_name", "filepath", "file_path", "path", "image", "image_name", "image_path", "img"),
    "place": ("place_name", "place_id"),
    "x": ("x_m", "easting", "east", "utm_easting", "utm_east", "pos_x"),
    "y": ("y_m", "northing", "north", "utm_northing", "utm_north", "pos_y"),
    "z": ("z_m", "up", "pos_z"),
    "lat": ("latitude", "gps_lat", "gps_latitude"),
    "lon": ("lng", "long", "longitude", "gps_lon", "gps_lng", "gps_longitude"),
    "alt": ("altitude", "alt_m", "elevation", "gps_alt", "gps_altitude"),
    "heading": ("heading_deg", "bearing", "azimuth", "compass", "compass_angle"),
    "captured_at": ("timestamp", "time", "datetime", "date_time", "taken_at", "capture_time"),
}
"""Our names of columns, and others that mean the same."""

NUMBERS = ("x", "y", "z", "lat", "lon", "alt", "heading")

MOST_ROWS = 200_000
LONGEST_PLACE = 200
LONGEST_FILE = 1024
"""Letters of a row's file, as of a name in an archive: reports tell of rows whose file is not there."""

_MEANT = {other: ours for ours, others in NAMES.items() for other in (ours, *others)}
_UNIX = re.compile(r"\d{9,19}(\.\d+)?", re.ASCII)
_MINUTE = re.compile(r"(19|20)\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])([01]\d|2[0-3])[0-5]\d", re.ASCII)
_SEPARATOR = re.compile(r"\s*sep=(\t|[^\w\s\"])\s*", re.IGNORECASE)
"""A line of a spreadsheet's own, before that of the columns."""
_COMMA = re.compile(r"[+-]?\d+,\d+", re.ASCII)
_METRES = frozenset(("x", "y", "z", "alt"))
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}", re.ASCII)  # in a table with commas between its columns
_RANGES = {"lat": 90.0, "lon": 180.0, "heading": 360.0} | dict.fromkeys(("x", "y", "z", "alt"), values.FARTHEST_M)


@dataclass(frozen=True)
class Row:
    """One row of a manifest.

    Parameters
    ----------
    line : int
        Of the file, from 1.
    file : str
        Path of the image, with slashes.
    given : mapping of our names to values
        Without empty ones.
    further : mapping of str to values
        Columns that are not ours.
    """

    line: int
    file: str
    given: Mapping[str, Any]
    further: Mapping[str, Any]


@dataclass
class Manifest:
    """The rows of a manifest, found by the path of an image; each row is for the images whose path ends with its file.

    Parameters
    ----------
    name : str
        Of the manifest.
    columns : sequence of str
        Ours by our names.
    rows : sequence of Row

    Raises
    ------
    ValueError
        Two rows are about one file.
    """

    name: str
    columns: Sequence[str]
    rows: Sequence[Row]
    _by_file: dict[str, Row] = field(default_factory=dict)
    _used: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        for row in self.rows:
            if row.file in self._by_file:
                first = self._by_file[row.file].line
                raise ValueError(f"{self.name}: lines {first} and {row.line} are both about {row.file}")
            self._by_file[row.file] = row

    def of(self, path: str) -> Row | None:
        """The row of an image, or None; the row that names most of the image's folders comes first."""
        parts = values.composed(path).split("/")
        for begin in range(len(parts)):
            name = "/".join(parts[begin:])
            if name in self._by_file:
                self._used.add(name)
                return self._by_file[name]
        return None

    def unused(self) -> list[Row]:
        """Rows that `of` has not returned, in order."""
        return [row for row in self.rows if row.file not in self._used]


def read_manifest(name: str, content: bytes) -> Manifest:
    """Read a manifest, lines of JSON when its name ends with ``.ndjson`` or ``.jsonl``, else CSV.

    Raises
    ------
    ValueError
        It cannot be used as a whole. What is wrong with a single value is said by `attributes`.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{name}: not a text file in UTF-8; spreadsheets save it so as CSV UTF-8") from None
    read = _json_rows if name.lower().endswith((".ndjson", ".jsonl")) else _table_rows
    return Manifest(name, *read(name, text))


def attributes(row: Row, name: str) -> ViewAttributes:
    """The attributes that a row gives; raises ValueError with all that is wrong.

    Metres win over degrees where a row has both; the degrees are kept as metadata.
    """
    wrong: list[str] = []
    given = dict(row.given)
    further = dict(row.further)
    if "x" in given and "lat" in given:
        further |= {frame: given.pop(frame) for frame in ("lat", "lon", "alt") if frame in given}
    numbers: dict[str, float] = {}
    for column in NUMBERS:
        if column in given:
            try:
                numbers[column] = _number(column, given[column])
            except ValueError as error:
                wrong.append(f"{column} {error}")
    for whole, halves in ((("x", "y"), ("x", "y", "z")), (("lat", "lon"), ("lat", "lon", "alt"))):
        there = [half for half in halves if half in given]
        if there and (lacking := [half for half in whole if half not in given]):
            wrong.append(f"{' and '.join(lacking)} is missing: {', '.join(there)} alone is half a position")
    named, moment = given.get("place"), None
    place = None if named is None else str(named)
    if isinstance(named, bool | list | dict):
        wrong.append(f"place is {str(named)[:40]!r}, which is no text")
    elif place is not None:
        try:
            place = values.place_name(place)
        except ValueError as error:
            wrong.append(f"place {error}")
        if len(place) > LONGEST_PLACE:
            wrong.append(f"place has {len(place)} letters; at most {LONGEST_PLACE} are taken")
    if "captured_at" in given:
        try:
            moment = _moment(given["captured_at"])
        except ValueError as error:
            wrong.append(f"captured_at {error}")
    try:
        values.check_metadata(further)
    except ValueError as error:
        wrong.append(f"what is left as metadata {error}")
    if wrong:
        raise ValueError(f"{name}, line {row.line}: {'; '.join(wrong)}")
    return ViewAttributes(place, Position(**numbers), moment, further)


def _number(column: str, value: object) -> float:
    text = str(value).strip()
    try:
        number = (
            math.nan
            if isinstance(value, bool) or "_" in text  # Python alone reads 12_5 as 125
            else float(text.replace(",", ".") if _COMMA.fullmatch(text) else text)
        )
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"is {text[:40]!r}, which is no number")
    limit = _RANGES.get(column)
    if limit is not None and abs(number) > limit:
        unit = "metres" if limit == values.FARTHEST_M else "degrees"
        raise ValueError(f"is {number:g}; it needs to be between -{limit:g} and {limit:g} {unit}")
    return values.whole_turn(number % 360) if column == "heading" else number


def _moment(value: object) -> datetime:
    """A time: RFC 3339 with its zone, or Unix time in seconds, or whole milli-, micro- or nanoseconds."""
    text = str(value).strip()
    if not _UNIX.fullmatch(text):
        try:
            return values.moment(text)
        except ValueError as error:
            raise ValueError(f"{error}, or Unix time; it is {text[:40]!r}") from None
    whole = text.partition(".")[0]
    # As Unix time 20260301093000 would be after 2286, and 202603010930 in 1976: dates and times without a zone.
    if len(whole) in (11, 14, 17) or _MINUTE.fullmatch(whole):
        raise ValueError(f"is {text}, which is no Unix time of today; write dates as 2026-03-01T09:30:00Z")
    unit = 10 ** (3 * max(0, min(3, (len(whole) - 9) // 3)))  # digits today: 10 s, 13 ms, 16 us, 19 ns
    try:
        return datetime.fromtimestamp(float(text) / unit, UTC)
    except (OverflowError, OSError, ValueError):
        raise ValueError(f"is {text}, which is no Unix time") from None


def _named(name: str, columns: Iterable[str]) -> dict[str, str]:
    """Each column to our name for it, or to itself; raises ValueError when two mean the same."""
    first: dict[str, str] = {}
    for column in columns:
        ours = _MEANT.get(column.strip().lower().replace(" ", "_"), column.strip())
        if ours in first:
            raise ValueError(f"{name}: the columns {first[ours]!r} and {column!r} both mean {ours}")
        first[ours] = column
    return {column: ours for ours, column in first.items()}


def _row(name: str, line: int, named: Mapping[str, Any], metadata: Mapping[str, Any] | None = None) -> Row:
    """A row of named values and metadata: a name of ours within metadata says nothing of the view."""
    file = values.composed(str(named["file"]).strip().replace("\\", "/").removeprefix("./"))
    if len(file) > LONGEST_FILE:
        letters = f"names a file of {len(file):,} letters; at most {LONGEST_FILE:,} are taken"
        raise ValueError(f"{name}, line {line}: {letters}")
    given = {key: value for key, value in named.items() if key in NAMES and key != "file"}
    further = {key: value for key, value in named.items() if key not in NAMES}
    return Row(line, file, given, {**(metadata or {}), **further})


def _table_rows(name: str, text: str) -> tuple[list[str], list[Row]]:
    first = next((line for line in _lines(text) if line.strip()), "")
    if said := _SEPARATOR.fullmatch(first):
        delimiter = said[1]
        text = text.replace(first, "\n", 1)  # lines are counted as they are in the file
    else:
        delimiter = max(",;\t", key=first.count)
    reader = csv.reader(_lines(text), delimiter=delimiter)
    rows: list[Row] = []
    columns: list[str] = []
    named: dict[str, str] = {}
    try:
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if not columns:
                columns = [cell.strip().lstrip("#").strip() for cell in cells]
                while len(columns) > 1 and not columns[-2] and not columns[-1]:  # spreadsheets keep emptied columns
                    columns.pop()
                named = _named(name, columns)
                if "file" not in named.values():
                    raise ValueError(f"{name}: the first line needs to name a column file, beside {', '.join(NAMES)}")
                continue
            while len(cells) > len(columns) and not cells[-1].strip():
                cells.pop()
            if len(cells) > len(columns):
                many = f"{len(cells)} values, and the first line names {len(columns)} columns"
                raise ValueError(f"{name}, line {reader.line_num}: {many}")
            filled = {named[c]: cell.strip() for c, cell in zip(columns, cells, strict=False) if cell.strip()}
            if "file" not in filled:
                raise ValueError(f"{name}, line {reader.line_num}: names no file")
            for column in _METRES & filled.keys() if delimiter == "," else ():
                if _THOUSANDS.fullmatch(filled[column]):
                    either = f"is {filled[column]!r}, which may have a comma for thousands or for decimals"
                    raise ValueError(f"{name}, line {reader.line_num}: {column} {either}; write it without")
            rows.append(_row(name, reader.line_num, filled))
            _count(name, rows)
        _check_quotes(text, delimiter)
    except csv.Error as error:
        raise ValueError(f"{name}, line {reader.line_num}: {error}") from None
    if not columns:
        raise ValueError(f"{name}: is empty; the first line needs to name columns")
    return [column for column in named.values() if column or any("" in row.further for row in rows)], rows


def _lines(text: str) -> io.StringIO:
    """Lines that end with LF, CR or both, each with its end: other characters that break lines are text."""
    return io.StringIO(text, newline="")


def _check_quotes(text: str, delimiter: str) -> None:
    """Raise csv.Error when the last value is quoted and never ends: it would hold all rows behind its quote."""
    try:
        for _ in csv.reader(_lines(text), delimiter=delimiter, strict=True):
            pass
    except csv.Error as error:
        if "end of data" in str(error):
            raise csv.Error("a quoted value that begins on an earlier line, or here, is not closed") from None


def _json_rows(name: str, text: str) -> tuple[list[str], list[Row]]:
    rows: list[Row] = []
    columns: dict[str, None] = {}
    for number, line in enumerate(_lines(text), start=1):
        if not line.strip():
            continue
        try:
            value = values.strict_json(line)
        except ValueError as error:
            raise ValueError(f"{name}, line {number}: {error}") from None
        if not isinstance(value, dict):
            raise ValueError(f"{name}, line {number}: needs to be a JSON object")
        meant = _named(f"{name}, line {number}", value)
        columns |= dict.fromkeys(meant.values())
        filled = {meant[key]: inner for key, inner in value.items() if inner is not None and inner != ""}
        if not isinstance(filled.get("file"), str):
            raise ValueError(f"{name}, line {number}: names no file")
        inner = filled.pop("metadata", {})
        rows.append(_row(name, number, filled, inner if isinstance(inner, dict) else {"metadata": inner}))
        _count(name, rows)
    return [*columns], rows


def _count(name: str, rows: Sequence[Row]) -> None:
    if len(rows) > MOST_ROWS:
        raise ValueError(f"{name}: has more than {MOST_ROWS:,} rows; send the recording in parts")
