"""Zip archives as other programs write them: the names of their files, and the order of these."""

import io
import unicodedata
import zipfile
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given, strategies as st

from schemas.errors import BadBody
from schemas.imports import ImportOptions
from schemas.values import in_order
from tests.sample_images import photo
from tests.stories.importing import zipped
from worker.images import codec
from worker.service.archives import Archive
from worker.service.recordings import Limits, Recording, open_archive
from worker.service.thinning import thin

LIMITS = Limits(codec.Limits(), 10_000_000, 20)


def without_flag(files: Mapping[str, bytes | str]) -> bytes:
    """An archive with names in UTF-8 that does not say so, as macOS and, in the locale C, `zip` write them."""
    archive = bytearray(zipped(files))
    for begin, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = archive.find(begin)
        while at >= 0:
            archive[at + flags + 1] &= ~0x08
            at = archive.find(begin, at + 4)
    return bytes(archive)


def opened(path: Path, data: bytes) -> Recording:
    path.write_bytes(data)
    return open_archive(path, LIMITS)


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_names_in_utf_8_are_read_whether_the_archive_says_so_or_not(
    tmp_path: Path, form: Literal["NFC", "NFD"]
) -> None:
    name = unicodedata.normalize(form, "Höfe/Straße é.jpg")
    data = without_flag({name: photo(1), "manifest.csv": "file,x,y\nStraße é.jpg,1,2\n"})
    assert zipfile.ZipFile(io.BytesIO(data)).namelist()[0] != name

    with opened(tmp_path / "a.zip", data) as recording:
        (item,) = recording.items
        assert (item.file, item.read(), recording.notes) == (name, photo(1), [])
        assert (item.attributes.position.x, item.attributes.filename) == (1, name.rpartition("/")[2])


def test_names_of_older_systems_are_read_as_theirs(tmp_path: Path) -> None:
    data = zipped({"h.he.jpg": photo(1)}).replace(b"h.he.jpg", "höhe.jpg".encode("cp437"))
    with opened(tmp_path / "a.zip", data) as recording:
        assert [(item.file, item.read()) for item in recording.items] == [("höhe.jpg", photo(1))]


def test_a_name_that_leads_out_is_found_however_it_is_written(tmp_path: Path) -> None:
    (path := tmp_path / "a.zip").write_bytes(without_flag({"é/../../a.jpg": photo(1)}))
    with pytest.raises(BadBody, match="leads out of the archive"):
        Archive(path, 10_000_000)


def test_the_time_of_day_in_a_name_is_no_drive(tmp_path: Path) -> None:
    with opened(tmp_path / "a.zip", zipped({"9:30.jpg": photo(1), "10:30.jpg": photo(2)})) as recording:
        assert [item.file for item in recording.items] == ["9:30.jpg", "10:30.jpg"]
    for name in ("c:/photos/a.jpg", "C:a.jpg", "C:\\a.jpg"):
        with pytest.raises(BadBody, match="is absolute"):
            opened(tmp_path / "a.zip", zipped({name: photo(1)}))


def test_images_are_in_the_order_in_which_they_were_counted(tmp_path: Path) -> None:
    names = ["left/9.jpg", "left/10.jpg", "right/1.jpg", "right/1.25.jpg", "right/1.5.jpg", "right/11.jpg"]
    (path := tmp_path / "a.zip").write_bytes(zipped({name: photo(1) for name in reversed(names)}))
    with closing(Archive(path, 10_000_000)) as archive:
        assert [entry.name for entry in archive.images] == names


def test_poses_in_order_go_to_frames_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    """Frames from 1 on without zeros before, as `ffmpeg walk.mp4 %d.jpg` writes them: 10.jpg has the tenth pose."""
    poses = "".join(f"1 0 0 {number} 0 1 0 0 0 0 1 0\n" for number in range(1, 13))
    for written in ("{}.jpg", "frame{}.jpg"):
        images = {written.format(number): photo(number) for number in range(1, 13)}
        with opened(tmp_path / "a.zip", zipped({**images, "poses.txt": poses})) as recording:
            assert {item.file: item.attributes.position.x for item in recording.items} == {
                written.format(number): number for number in range(1, 13)
            }


def test_the_depth_images_of_a_benchmark_are_no_views(tmp_path: Path) -> None:
    """As TUM's RGB-D benchmark is downloaded, their times some milliseconds beside those of the photos."""
    files: dict[str, bytes | str] = {f"desk/rgb/{n}.50.png": photo(n, "png") for n in range(4)}
    files |= {f"desk/depth/{n}.51.png": photo(n + 4, "png") for n in range(3)}
    files["desk/rgb.txt"] = "# timestamp filename\n" + "".join(f"{n}.50 rgb/{n}.50.png\n" for n in range(4))
    files["desk/depth.txt"] = "# timestamp filename\n" + "".join(f"{n}.51 depth/{n}.51.png\n" for n in range(3))
    files["desk/groundtruth.txt"] = "".join(f"{n}.50 {n} 0 0 0 0 0 1\n" for n in range(4))

    with opened(tmp_path / "a.zip", zipped(files)) as recording:
        assert [(item.file, item.attributes.position.x) for item in recording.items] == [
            (f"desk/rgb/{n}.50.png", n) for n in range(4)
        ]
        assert (recording.left_out, recording.notes) == (3, [])
        thin(recording, ImportOptions(every_m=2))
        assert (len(recording.items), recording.left_out) == (2, 5)


def test_photos_are_no_depth_images_of_the_same_names(tmp_path: Path) -> None:
    """As a recorder writes them that lists each folder in the folder itself."""
    files: dict[str, bytes | str] = {f"{kind}/{n}.png": photo(n, "png") for n in range(2) for kind in ("rgb", "depth")}
    files |= {f"{kind}/{kind}.txt": "5 0.png\n9 1.png\n" for kind in ("rgb", "depth")}
    files["poses.txt"] = "5 5 0 0 0 0 0 1\n9 9 0 0 0 0 0 1\n"
    with opened(tmp_path / "a.zip", zipped(files)) as recording:
        found = [(item.file, item.attributes.position.x) for item in recording.items]
        assert (found, recording.left_out) == ([("rgb/0.png", 5), ("rgb/1.png", 9)], 2)


def test_times_are_those_of_the_list_beside_the_images(tmp_path: Path) -> None:
    """Two cameras, say, each with a list of its own that names the same files."""
    files: dict[str, bytes | str] = {f"{side}/rgb/0.png": photo(n, "png") for n, side in enumerate(("left", "right"))}
    files |= {"left/rgb.txt": "5 rgb/0.png\n", "right/rgb.txt": "9 rgb/0.png\n"}
    files["poses.txt"] = "5 5 0 0 0 0 0 1\n9 9 0 0 0 0 0 1\n"
    with opened(tmp_path / "a.zip", zipped(files)) as recording:
        assert [item.attributes.position.x for item in recording.items] == [5, 9]
    lists = {"rgb.txt": "5 rgb/0.png\n9 rgb/0.png\n", "right/rgb.txt": ""}
    with pytest.raises(BadBody, match=r"rgb.txt, line 2: rgb/0.png has two times, 5 and 9 s"):
        opened(tmp_path / "a.zip", zipped({**files, **lists}))


def test_what_is_left_out_is_not_told_of_as_enrolled(tmp_path: Path) -> None:
    images = {f"{number}.jpg": photo(number) for number in range(5)}
    rows = "".join(f"{number}.jpg,{1767225600 + number}\n" for number in range(4))
    with opened(tmp_path / "a.zip", zipped({**images, "manifest.csv": "file,time\n" + rows})) as recording:
        assert [note.detail for note in recording.notes] == [
            "manifest.csv has no row for it; it is enrolled without position"
        ]
        thin(recording, ImportOptions(every_s=2))
        assert [item.file for item in recording.items] == ["0.jpg", "2.jpg"]
        assert [(note.file, note.detail) for note in recording.notes] == [
            ("4.jpg", "has no time, by which `every` chooses; it was left out")
        ]


def test_a_manifest_that_names_none_of_the_images_is_refused(tmp_path: Path) -> None:
    """Of another machine's paths, say: all images would be enrolled, and none of them where it was taken."""
    images = {f"walk/{number}.jpg": photo(number) for number in range(3)}
    rows = "".join(f"/home/anna/walk/{number}.jpg,1,2\n" for number in range(3))
    with pytest.raises(BadBody, match=r"no row names the end .* line 2 has '/home/anna/walk/0.jpg', .* 'walk/0.jpg'"):
        opened(tmp_path / "a.zip", zipped({**images, "manifest.csv": "file,x,y\n" + rows}))
    with opened(tmp_path / "a.zip", zipped({**images, "manifest.csv": f"file,x,y\n{rows}2.jpg,3,4\n"})) as recording:
        assert [item.attributes.position.x for item in recording.items] == [None, None, 3]


@given(st.lists(st.text("ab.-/019", max_size=12), unique=True))
def test_any_names_have_an_order(names: list[str]) -> None:
    assert sorted(sorted(names, key=in_order, reverse=True), key=in_order) == sorted(names, key=in_order)


@given(st.lists(st.integers(0, 10**6), unique=True), st.sampled_from(["{}.jpg", "{:09}.jpg", "walk 2/f{}_x.png"]))
def test_numbers_in_names_are_in_their_order(numbers: list[int], written: str) -> None:
    assert sorted(map(written.format, numbers), key=in_order) == [written.format(n) for n in sorted(numbers)]


@given(st.lists(st.integers(0, 10**7), unique=True))
def test_seconds_in_names_are_in_their_order(millis: list[int]) -> None:
    seconds = [milli / 1000 for milli in millis]
    assert sorted(map(str, seconds), key=in_order) == [str(second) for second in sorted(seconds)]
