"""What the EXIF of images says, and what goes before it."""

import json
from pathlib import Path

import pytest
from PIL import Image as PilImage
from PIL.TiffImagePlugin import IFDRational

from app.cli.__main__ import main
from lab.faults.heics import heics
from worker.images.exif import read_exif

Out = pytest.CaptureFixture[str]


def test_exif_gives_position_heading_and_time(tmp_path: Path) -> None:
    path = tmp_path / "photo.jpg"
    exif = PilImage.Exif()
    gps = exif.get_ifd(0x8825)
    gps[1], gps[2] = "S", (IFDRational(33), IFDRational(51), IFDRational(36))
    gps[3], gps[4] = "E", (IFDRational(151), IFDRational(12), IFDRational(0))
    gps[6], gps[16], gps[17] = IFDRational(20), "T", IFDRational(270)
    gps[29], gps[7] = "2026:03:01", (IFDRational(9), IFDRational(30), IFDRational(0))
    PilImage.new("RGB", (40, 40)).save(path, exif=exif)

    known = read_exif(path)

    assert known["lat"] == pytest.approx(-33.86)
    assert known["lon"] == pytest.approx(151.2)
    assert (known["alt"], known["heading"]) == (20, 270)
    assert known["captured_at"].isoformat() == "2026-03-01T09:30:00+00:00"


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("1,2,,,", {"x": 1.0, "y": 2.0}),
        ("1,2,,,45", {"x": 1.0, "y": 2.0, "heading": 45.0}),
        (",,50,14,", {"lat": 50.0, "lon": 14.0, "heading": 270.0}),
        (",,,,", {"lat": -33.0, "lon": 151.0, "heading": 270.0}),
    ],
)
def test_north_is_no_direction_of_a_frame_in_metres(
    tmp_path: Path, capsys: Out, row: str, told: dict[str, float]
) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "S", 2: (33.0, 0.0, 0.0), 3: "E", 4: (151.0, 0.0, 0.0), 16: "T", 17: 270.0})
    PilImage.new("RGB", (40, 40)).save(tmp_path / "a.jpg", exif=exif)
    (tmp_path / "p.csv").write_text(f"file,x,y,lat,lon,heading\na.jpg,{row}\n")

    table = ["--exif", "--positions", str(tmp_path / "p.csv")]
    assert main(["enroll", str(tmp_path / "a.jpg"), *table, "--dry-run", "--json"]) == 0

    (one,) = json.loads(capsys.readouterr().out)["would_enroll"]
    assert {name: one[name] for name in ("x", "y", "lat", "lon", "heading") if name in one} == told


def test_images_without_exif_and_files_that_are_none_say_nothing(tmp_path: Path) -> None:
    PilImage.new("RGB", (40, 40), "red").save(tmp_path / "b.png")
    (tmp_path / "notes.txt").write_text("no picture")

    assert read_exif(tmp_path / "b.png") == {}
    assert read_exif(tmp_path / "notes.txt") == {}


def test_one_damaged_file_leaves_the_exif_of_the_others(tmp_path: Path, capsys: Out) -> None:
    """libheif's reader ends the process for a name that is no UTF-8."""
    sound = heics()["turned"]
    at = sound.index(b"Exif")
    for name, data in {"b.heic": sound[:at] + b"\x80" + sound[at + 1 :], "a.heic": sound}.items():
        (tmp_path / name).write_bytes(data)
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "S", 2: (33.0, 0.0, 0.0), 3: "E", 4: (151.0, 0.0, 0.0)})
    PilImage.new("RGB", (40, 40)).save(tmp_path / "c.jpg", exif=exif)
    with (tmp_path / "d.tif").open("wb") as scan:
        scan.truncate(3 * 10**9)  # is not read: no service takes it

    assert main(["enroll", str(tmp_path), "--exif", "--dry-run", "--json"]) == 0

    seen = capsys.readouterr()
    told = json.loads(seen.out)["would_enroll"]
    assert "b.heic: its EXIF is not read" in seen.err
    assert [(Path(one["file"]).name, one.get("lat")) for one in told][1:] == [
        ("b.heic", None),
        ("c.jpg", -33.0),
        ("d.tif", None),
    ]
