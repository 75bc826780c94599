"""Videos: frames at regular times, decoded in a process of their own."""

import hashlib
import json
import signal
import subprocess
import threading
from collections import OrderedDict
from pathlib import Path

from schemas.errors import BadBody, BodyTooLarge
from worker.images.apart.launching import launched
from worker.images.apart.video_child import HEADER
from worker.images.codec import Limits

CHILD = "worker.images.apart.video_child"

KEPT = 16
"""Frames kept after they were read: some are read twice, and a few at once."""

_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")  # with one of which MP4 and QuickTime begin


class Repeated(Exception):
    """A frame that is the same as an earlier one of its video."""


def is_video(head: bytes) -> bool:
    """Whether a file is a video, by its first 16 bytes: MP4, QuickTime, Matroska, WebM or AVI."""
    if head[:4] == b"RIFF":
        return head[8:12] == b"AVI "
    return head[4:8] in _BOXES or head[:4] == b"\x1a\x45\xdf\xa3"


class Video:
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

    Attributes
    ----------
    times_s : list of float
        When the frames are shown, ascending.

    Raises
    ------
    BadBody, BodyTooLarge
    """

    def __init__(self, path: Path, every_s: float, limits: Limits, deadline_s: float) -> None:
        self._arguments = (path, every_s, limits.max_pixels, deadline_s)
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._ended: str | None = None  # why no more frames come
        self._kept: OrderedDict[int, bytes] = OrderedDict()
        self._first: dict[bytes, int] = {}
        with launched(CHILD, ("times", *self._arguments), stdout=subprocess.PIPE) as process:
            answer, _ = process.communicate()
        if process.returncode:
            raise _refused(_how(process.returncode))
        known = json.loads(answer)
        if known["width"] * known["height"] > limits.max_pixels:
            size = f"{known['width']} x {known['height']}"
            raise BodyTooLarge(f"the frames of the video have {size} pixels; at most {limits.max_pixels:,} are taken")
        if not known["decodes"]:
            raise _refused(f"it is damaged, or its codec ({known['codec']}) is not known here; H.264 is")
        self.times_s: list[float] = known["times_s"]
        self._numbers = {time: number for number, time in enumerate(self.times_s)}

    def read(self, number: int) -> bytes:
        """A frame as a JPEG, the same bytes each time. Each is to be read soon after the one before.

        Raises
        ------
        Repeated
        ValueError
            It cannot be decoded.
        """
        with self._lock:
            while number not in self._kept and self._ended is None and number > max(self._kept, default=-1):
                self._receive()
            if number not in self._kept:
                raise ValueError(self._ended or "is damaged in the video")
            jpeg = self._kept[number]
            if self._first.setdefault(hashlib.sha256(jpeg).digest(), number) != number:
                raise Repeated
            return jpeg

    def close(self) -> None:
        """End its process; who reads meanwhile is told that no more frames come."""
        if self._process is not None:
            self._process.kill()
        with self._lock:
            self._end()
            self._ended = "is not read any more"

    def _end(self) -> int:
        """Wait for the process to end; returns its code."""
        if self._process is None or self._process.stdout is None:
            return 0
        self._process.stdout.close()
        return self._process.wait()

    def _receive(self) -> None:
        """Keep the next frame that is sent, or learn that there is none."""
        if self._process is None:
            self._process = launched(CHILD, ("frames", *self._arguments), stdout=subprocess.PIPE)
        assert self._process.stdout is not None
        header = self._process.stdout.read(HEADER.size)
        if len(header) == HEADER.size:
            time, length = HEADER.unpack(header)
            jpeg = self._process.stdout.read(length)
            if len(jpeg) == length:
                self._kept[self._numbers[time]] = jpeg
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
                return
        code = self._end()
        self._ended = f"cannot be read: {_how(code)}" if code else "is damaged, or the video breaks off before"


def _how(code: int) -> str:
    if code == -signal.SIGALRM:
        return "reading it took too long"
    return f"reading it ended its process ({signal.Signals(-code).name if code < 0 else f'code {code}'})"


def _refused(why: str) -> BadBody:
    return BadBody("malformed-body", f"the video is refused: {why}")
