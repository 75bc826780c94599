"""Videos: frames at regular times, decoded in a process of their own."""

from pathlib import Path

from schemas.errors import BadBody, BodyTooLarge
from worker.images.apart.stream import Ended, ImageStream
from worker.images.codec import Limits

_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # with one of which MP4 and QuickTime begin

LEAST_MISSING_S, LEAST_MISSING_SHARE = 2.0, 0.02
"""Of a video that breaks off; its sound may be a little longer than its images."""


def is_video(head: bytes) -> bool:
    """Whether a file is a video, by its first 16 bytes: MP4, QuickTime, Matroska, WebM or AVI."""
    if head[:4] == b"RIFF":
        return head[8:12] == b"AVI "
    return head[4:8] in _BOXES or head[:4] == b"\x1a\x45\xdf\xa3"


class Video(ImageStream):
    """The frames of a video that are shown first at or after each multiple of a time.

    Parameters
    ----------
    path : Path
    every_s : float
        Seconds from one to the next, above 0.
    limits : Limits
        Of the size of a frame.
    deadline_s : float
        Seconds for decoding one frame.
    listing : Path or None
        As `kept` of `ImageStream.listed`.

    Attributes
    ----------
    times_s : list of float
        When the frames are shown, ascending.
    broken : str or None
        How far it goes where that is less than the file says.

    Raises
    ------
    BadBody, BodyTooLarge
    """

    CHILD = "worker.images.apart.video_child"

    def __init__(
        self, path: Path, every_s: float, limits: Limits, deadline_s: float, listing: Path | None = None
    ) -> None:
        super().__init__(self.CHILD, path, every_s, limits.max_pixels, deadline_s)
        try:
            known = self.listed(listing)
        except Ended as error:
            raise _refused(str(error)) from None
        if known["width"] * known["height"] > limits.max_pixels:
            size = f"{known['width']} x {known['height']}"
            raise BodyTooLarge(f"the frames of the video have {size} pixels; at most {limits.max_pixels:,} are taken")
        if not known["decodes"]:
            raise _refused(f"it is damaged, or its codec ({known['codec']}) is not known here; H.264 is")
        self.times_s: list[float] = known["times_s"]
        seen_s, stated_s = known["seen_s"], known["stated_s"]
        whole = stated_s - seen_s <= max(LEAST_MISSING_S, LEAST_MISSING_SHARE * stated_s)
        self.broken = None if whole else f"its images end after {seen_s:.1f} s; the file says it lasts {stated_s:.1f}"


def _refused(why: str) -> BadBody:
    return BadBody("malformed-body", f"the video is refused: {why}")
