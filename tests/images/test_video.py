"""Frames of videos: which are chosen, and what becomes of videos that are damaged or were made to do harm."""

from collections.abc import Sequence
from contextlib import closing
from itertools import cycle
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st

from schemas.errors import BadBody, BodyTooLarge
from tests.drawn_videos import cut, frames, turned, uneven, video
from worker.images.apart.edit_list import shown_s
from worker.images.apart.stream import Repeated
from worker.images.apart.video import Video, is_video
from worker.images.apart.video_child import chosen
from worker.images.codec import Limits

LIMITS = Limits(max_bytes=5_000_000, max_pixels=1_000_000)


def opened(path: Path, every_s: float = 1.0, limits: Limits = LIMITS, deadline_s: float = 20) -> Video:
    return Video(path, every_s, limits, deadline_s)


def unlike(jpeg: bytes, image: npt.NDArray[np.uint8]) -> float:
    """Mean difference of levels."""
    decoded = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    return float(np.abs(decoded.astype(int) - image).mean())


@given(st.lists(st.floats(0, 1e5), unique=True, max_size=60).map(sorted), st.floats(0.01, 100))
def test_of_frames_the_first_of_each_step_is_chosen(times_ms: Sequence[float], every_s: float) -> None:
    taken = chosen(list(times_ms), every_s)
    steps = [int((time + 0.5 - times_ms[0]) / (1000 * every_s)) for time in times_ms]
    first = dict(reversed(list(zip(steps, times_ms, strict=True))))
    assert taken == sorted(first.values())


@pytest.mark.parametrize(
    ("ending", "codec"), [("mp4", "mp4v"), ("avi", "MJPG"), ("mkv", "mp4v"), ("webm", "VP80"), ("mov", "MJPG")]
)
def test_the_frames_are_those_of_their_times(tmp_path: Path, ending: str, codec: str) -> None:
    path, images = tmp_path / f"a.{ending}", frames(22)
    assert is_video(video(path, images, 5, codec)[:16])

    with closing(opened(path.rename(tmp_path / "upload"))) as one:
        assert one.times_s == pytest.approx([0, 1, 2, 3, 4], abs=1e-3)
        for number in range(5):
            differences = [unlike(one.read(number), image) for image in images]
            assert int(np.argmin(differences)) == 5 * number
        assert one.read(4) == one.read(4)

    with closing(opened(tmp_path / "upload")) as again, closing(opened(tmp_path / "upload", 2)) as fewer:
        assert again.read(2) == fewer.read(1)  # the same bytes each time, whatever is left out


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_frames_of_a_phone_that_was_turned_are_upright(tmp_path: Path, degrees: int) -> None:
    (path := tmp_path / "a.mp4").write_bytes(turned(video(path, frames(6), 5, "mp4v"), degrees))
    with closing(opened(path)) as one:
        for number in range(2):
            assert unlike(one.read(number), np.rot90(frames(6)[5 * number], -degrees // 90)) < 6


def test_frames_are_read_a_little_out_of_turn(tmp_path: Path) -> None:
    video(path := tmp_path / "a.avi", frames(12), 1)
    with closing(opened(path)) as one:
        ahead = one.read(3)
        assert one.read(1) != ahead
        assert one.read(3) == ahead


def test_of_images_far_apart_those_that_are_wanted_are_kept_whoever_comes_first(tmp_path: Path) -> None:
    """Several threads read, and the one with the later image may be the first."""
    video(path := tmp_path / "a.avi", frames(40), 1)
    with closing(opened(path)) as one:
        one.wants([0, 35])
        later = one.read(35)
        assert one.read(0) != later


def test_a_frame_that_is_the_same_as_an_earlier_one_is_told_each_time(tmp_path: Path) -> None:
    still, other = frames(2)
    video(path := tmp_path / "a.avi", [still, other, still], 1)
    with closing(opened(path)) as one:
        one.read(0)
        one.read(1)
        for _ in range(2):
            with pytest.raises(Repeated):
                one.read(2)
        one.read(0)


def test_a_video_that_breaks_off_gives_the_frames_that_it_has(tmp_path: Path) -> None:
    whole = video(tmp_path / "a.avi", frames(20), 1)
    (path := tmp_path / "upload").write_bytes(whole[: len(whole) // 2])
    with closing(opened(path)) as one:
        assert 5 < len(one.times_s) < 15
        for number in range(len(one.times_s) - 1):
            one.read(number)
        assert one.broken is not None
        assert one.broken.endswith("the file says it lasts 20.0")


@pytest.mark.parametrize(("count", "per_second"), [(3, 0.2), (40, 25.0), (600, 30.0)])
@pytest.mark.parametrize("ending", ["avi", "mkv", "mp4"])
def test_a_whole_video_breaks_off_nowhere(tmp_path: Path, ending: str, count: int, per_second: float) -> None:
    video(path := tmp_path / f"a.{ending}", frames(3) * (count // 3), per_second, "mp4v")
    with closing(opened(path)) as one:
        assert one.broken is None


@pytest.mark.parametrize("shares", [(1.0,), (0.9, 1.23, 0.87, 1.01)], ids=["even", "uneven"])
@pytest.mark.parametrize(("start_s", "length_s"), [(3.4, 8.6), (0, 5), (3.4, 5)])
def test_of_a_video_that_was_cut_the_frames_are_those_that_are_shown(
    tmp_path: Path, shares: Sequence[float], start_s: float, length_s: float
) -> None:
    """What decoders need before the cut is still in the file; as many frames were told of, and missed."""
    images = frames(120)
    whole = uneven(video(tmp_path / "a.mp4", images, 10, "mp4v"), shares)
    times = np.cumsum([0, *(0.1 * share for share, _ in zip(cycle(shares), range(119), strict=False))])
    (path := tmp_path / "upload").write_bytes(cut(whole, start_s, length_s))

    with closing(opened(path)) as one:
        assert one.times_s == pytest.approx(np.arange(np.ceil(length_s)), abs=0.13)
        for number, second in enumerate(np.arange(np.ceil(length_s))):
            shown = int(np.argmin([unlike(one.read(number), image) for image in images]))
            assert 0 <= times[shown] - start_s - second + 0.0005 < 0.25
        assert one.broken is None


def test_where_an_edit_list_is_damaged_all_frames_are_told_of(tmp_path: Path) -> None:
    whole = cut(video(tmp_path / "a.mp4", frames(20), 10, "mp4v"), 0.4, 1)
    assert shown_s(tmp_path / "a.mp4") == pytest.approx(2)
    at = whole.index(b"moov")
    random = np.random.default_rng(1)
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[int(random.integers(at - 4, at + 600))] ^= 1 << int(random.integers(8))
        (path := tmp_path / "upload").write_bytes(damaged[: int(random.integers(at, len(whole)))])
        assert shown_s(path) is None or shown_s(path) >= 0  # type: ignore[operator]
    for other in (b"", b"\0" * 7, b"\0\0\0\1moov", bytes(100), PLAYLIST):
        path.write_bytes(other)
        assert shown_s(path) is None


def test_a_frame_that_is_damaged_is_left_out(tmp_path: Path) -> None:
    whole = bytearray(video(tmp_path / "a.avi", frames(10), 1))
    starts = [at for at in range(len(whole)) if whole[at : at + 2] == b"\xff\xd8"]
    whole[starts[4] : starts[5] - 16] = bytes(starts[5] - 16 - starts[4])
    (path := tmp_path / "upload").write_bytes(whole)
    with closing(opened(path)) as one:
        one.read(3)
        with pytest.raises(ValueError, match="damaged"):
            one.read(4)
        one.read(5)


PLAYLIST = b"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile:///etc/hostname\n#EXT-X-ENDLIST\n"


@pytest.mark.parametrize(
    "content",
    [b"", b"\0\0\0\x18ftypisom" + bytes(200), b"\x1a\x45\xdf\xa3" + bytes(5000), PLAYLIST, b"RIFF\0\0\0\0AVI LIST"],
)
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes) -> None:
    (path := tmp_path / "upload").write_bytes(content)
    with pytest.raises(BadBody, match="the video is refused"):
        opened(path)


def test_a_playlist_names_no_other_files(tmp_path: Path) -> None:
    """FFmpeg reads a playlist whatever is its name: it would open what the playlist names."""
    video(tmp_path / "secret.avi", frames(3), 1)
    (path := tmp_path / "upload").write_bytes(PLAYLIST.replace(b"/etc/hostname", bytes(tmp_path / "secret.avi")))
    with pytest.raises(BadBody):
        opened(path)
    (path := tmp_path / "upload2").write_bytes(b"ffconcat version 1.0\nfile secret.avi\n")
    with pytest.raises(BadBody):
        opened(path)


def test_frames_larger_than_images_may_be_are_refused(tmp_path: Path) -> None:
    video(path := tmp_path / "a.avi", frames(2, 128), 1)
    with pytest.raises(BodyTooLarge, match="128 x 128"):
        opened(path, limits=Limits(max_bytes=5_000_000, max_pixels=10_000))


def test_a_video_that_is_closed_while_it_is_read_says_so(tmp_path: Path) -> None:
    video(path := tmp_path / "a.avi", frames(40, 512), 1)
    one = opened(path)
    one.read(0)
    one.close()
    with pytest.raises(ValueError, match="not read any more"):
        [one.read(number) for number in range(1, 40)]


def test_what_is_in_a_video_is_looked_up_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, kept = tmp_path / "upload", tmp_path / "listing.json"
    video(tmp_path / "a.mp4", frames(10), 5, "mp4v")
    (tmp_path / "a.mp4").rename(path)
    looked: list[float] = []
    listing = Video._list

    def counted(self: Video) -> bytes:
        looked.append(1)
        return listing(self)

    monkeypatch.setattr(Video, "_list", counted)

    def times(at: Path, every_s: float) -> list[float]:
        with closing(Video(at, every_s, LIMITS, 20, kept)) as one:
            assert len(one.read(1)) > 100
            return one.times_s

    first = times(path, 1.0)
    moved = path.rename(tmp_path / "elsewhere")
    assert times(moved, 1.0) == first
    assert len(looked) == 1
    assert times(moved, 0.2) != first  # something else was asked
    assert len(looked) == 2
    assert times(moved, 1.0) == first
    assert len(looked) == 3
    content = bytearray(kept.read_bytes())
    content[-20] ^= 1
    for damaged in (bytes(content), b"", b"\n", content[:-5]):
        kept.write_bytes(damaged)
        looked.clear()
        assert times(moved, 1.0) == first
        assert len(looked) == 1
    kept.unlink()
    kept.mkdir()  # cannot be written
    assert times(moved, 1.0) == first
