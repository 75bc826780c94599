"""The process that reads a video: ``python -m worker.images.apart.video_child WHAT PATH EVERY_S MAX_PIXELS SECONDS``.

``list``: when the chosen frames are shown, and what is known of all; ``send``: each of them as a JPEG, as `ImageStream`
wants them. FFmpeg may open nothing but this one file.
"""

import json
import math
import os
import signal
import sys
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from worker.images.apart.edit_list import shown_s
from worker.images.apart.restraints import restrict, take_stdout
from worker.images.apart.stream import HEADER

QUALITY = 95
"""Of the JPEGs."""

MILLI = 1e-3
TOLERANCE_MS = 0.5
"""By which the times of two readings of a frame may differ."""

SLACK_MS = 200
"""By which they may differ where a video was cut: packets are counted from the one that decoding begins at."""

MOST_FRAMES = 10_000_000

MOST_CHOSEN = 100_000
"""Frames that are told of: more than are taken, so that it is seen that there are too many."""

FIRST = 100
"""Frames of which one must be decoded."""

SCAN_S = 120
"""Seconds for reading when all frames are shown."""

CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi"
"""Names of the formats that FFmpeg may use; none of them names other files."""


def _step(times_ms: list[float], time: float, every_s: float) -> int:
    """Which multiple of `every_s` after the first frame a time is at or after."""
    return math.floor((time + TOLERANCE_MS - times_ms[0]) / (every_s / MILLI))


def chosen(times_ms: list[float], every_s: float) -> list[float]:
    """Of frames at sorted times, the first at or after each multiple of `every_s` from the first frame on."""
    frames: list[float] = []
    due = times_ms[0] if times_ms else 0.0
    for time in times_ms:
        if time >= due - TOLERANCE_MS:
            frames.append(time)
            steps = _step(times_ms, time, every_s) + 1
            due = times_ms[0] + steps * every_s / MILLI
    return frames


def main(arguments: list[str]) -> None:
    """Answer on standard output."""
    what, video = arguments[0], Path(arguments[1])
    every_s, max_pixels, seconds = float(arguments[2]), int(arguments[3]), float(arguments[4])
    answers = take_stdout()
    os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = f"protocol_whitelist;file|format_whitelist;{CONTAINERS}"
    import cv2

    cv2.setNumThreads(1)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    restrict(max_pixels)
    signal.alarm(SCAN_S)
    os.chdir(video.parent)  # OpenCV crashes where a folder's name is not UTF-8
    path = video.name
    times = _times(cv2, path)
    if what == "list":
        signal.alarm(math.ceil(seconds) + 1)
        answers.write(json.dumps(_described(cv2, path, times, every_s, max_pixels)).encode())
    else:
        for number, frame in _frames(cv2, path, times, every_s, math.ceil(seconds) + 1):
            made, jpeg = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
            signal.alarm(0)  # the reader may take its time
            if made:
                answers.write(HEADER.pack(number, jpeg.size) + jpeg.tobytes())
                answers.flush()
    answers.flush()


def _opened(cv2: Any, path: str, options: list[int]) -> Any:
    return cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1, *options])


def _times(cv2: Any, path: str) -> list[float]:
    """Times of all frames in ms, sorted, from their packets, without decoding.

    Of a video that was cut those behind its end are left out: as many are decoded before its begin, and not shown.
    """
    video = _opened(cv2, path, [cv2.CAP_PROP_FORMAT, -1])
    times: list[float] = []
    while len(times) < MOST_FRAMES and video.grab():
        times.append(video.get(cv2.CAP_PROP_POS_MSEC))
    times.sort()
    shown = shown_s(Path(path))
    inside = len(times) if shown is None else bisect_left(times, shown / MILLI - TOLERANCE_MS)
    return times[:inside] if inside < len(times) - 1 else times  # the last frame of some files lasts no time


def _described(cv2: Any, path: str, times: list[float], every_s: float, max_pixels: int) -> dict[str, Any]:
    """When the chosen frames are shown, and how large all are; how long all last, and how long the file says that they
    do; whether the first can be decoded."""
    video = _opened(cv2, path, [])
    width, height = (int(video.get(side)) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    code = int(video.get(cv2.CAP_PROP_FOURCC))
    count, rate = video.get(cv2.CAP_PROP_FRAME_COUNT), video.get(cv2.CAP_PROP_FPS)
    stated_s = shown_s(Path(path)) or (count / rate if count > 0 and rate > 0 else 0.0)
    return {
        "times_s": [time * MILLI for time in chosen(times, every_s)[:MOST_CHOSEN]],
        "seen_s": (times[-1] - times[0]) * MILLI + 1 / rate if times and rate > 0 else 0.0,
        "stated_s": stated_s,
        "width": width,
        "height": height,
        "codec": "".join(chr(code >> 8 * i & 0xFF) for i in range(4)) if code > 0 else "unknown",
        "decodes": 0 < width * height <= max_pixels and any(video.grab() for _ in times[:FIRST]),
    }


def _frames(cv2: Any, path: str, times: list[float], every_s: float, seconds: int) -> Iterator[tuple[int, Any]]:
    """The chosen of all frames, numbered; those that cannot be decoded are left out."""
    video = _opened(cv2, path, [])
    wanted = chosen(times, every_s)
    number = 0
    for _ in times:  # a frame that is damaged does not end the video
        if number == len(wanted):
            return
        signal.alarm(seconds)
        if not video.grab():
            continue
        time = video.get(cv2.CAP_PROP_POS_MSEC)
        step = _step(times, time, every_s)
        while number + 1 < len(wanted) and _step(times, wanted[number + 1], every_s) <= step:
            number += 1
        if wanted[number] >= time - SLACK_MS and _step(times, wanted[number], every_s) <= step:
            good, frame = video.retrieve()
            if good:
                yield number, frame
            number += 1


if __name__ == "__main__":
    main(sys.argv[1:])
