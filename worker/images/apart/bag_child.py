"""The process that reads MCAP: ``python -m worker.images.apart.bag_child WHAT PATH TOPIC MAX_BYTES MAX_PIXELS``.

``list``: when each image was taken, and all poses, by topic; ``send``: the images of TOPIC, as `ImageStream` wants
them. The file is read from its beginning, without its index: of one whose recorder was killed, as far as it goes.
"""

import json
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from math import atan2, degrees, inf, isfinite
from pathlib import Path
from typing import Any

from schemas.values import FARTHEST_M, whole_turn
from worker.images.apart.restraints import restrict, take_stdout
from worker.images.apart.stream import HEADER

IMAGES = ("sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image")
POSES = (
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/NavSatFix",
)

LIST_S, SEND_S = 300, 120
"""Seconds for reading all of a file, and for finding the next image."""

MOST_LISTED, MOST_TOPICS = 1_000_000, 1_000
"""Images and poses, and topics, that are told of."""

LONGEST_TOPIC = 255
"""Letters of a topic that is told of, as parameters name one: each image of a recording is named by its topic."""

MOST_ENCODINGS = 10
"""That are told of by name."""

CLOSEST_S = 0.02
"""Seconds between poses that are listed."""

LEAST_UNIX_S = 1e8
"""Smallest time that counts as Unix time: a simulation counts from its start."""

QUALITY = 95
"""Of the JPEGs that are made of images without compression."""

CODES = {
    "rgb8": ("RGB2BGR", 3),
    "bgr8": (None, 3),
    "mono8": (None, 1),
    "rgba8": ("RGBA2BGR", 4),
    "bgra8": ("BGRA2BGR", 4),
}
"""By encoding: the conversion of OpenCV, and bytes for each pixel."""


def main(arguments: list[str]) -> None:
    """Answer on standard output."""
    what, path, topic = arguments[:3]
    max_bytes, max_pixels = map(int, arguments[3:5])
    answers = take_stdout()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    import cv2
    import lz4.frame  # noqa: F401 - before opening files is restricted
    import zstandard  # noqa: F401
    from mcap_ros2.decoder import DecoderFactory

    cv2.setNumThreads(1)
    restrict(max_pixels)
    decoders = DecoderFactory()
    if what == "list":
        signal.alarm(LIST_S)
        answers.write(json.dumps(_listed(Path(path), decoders)).encode())
    else:
        signal.alarm(SEND_S)
        for number, image in enumerate(_decoded(Path(path), decoders, topic)):
            data = _usable(cv2, image, max_bytes, max_pixels)
            signal.alarm(0)  # the reader may take its time
            if data is not None:
                answers.write(HEADER.pack(number, len(data)) + data)
                answers.flush()
            signal.alarm(SEND_S)
    answers.flush()


def _messages(path: Path, broken: list[str]) -> Iterator[tuple[Any, Any, Any]]:
    """Schema, channel and message of all that is in the file; why it cannot be read further is added to `broken`."""
    from mcap.reader import NonSeekingReader

    with path.open("rb") as file:
        try:
            yield from NonSeekingReader(file).iter_messages(log_time_order=False)
        except Exception as error:  # of struct and zstd too, by where it is cut or damaged
            broken.append(f"{type(error).__name__}: {error}")


def _decoded(path: Path, decoders: Any, topic: str) -> Iterator[Any]:
    for schema, channel, message in _messages(path, []):
        if channel.topic == topic and schema is not None and schema.name in IMAGES:
            yield _message(decoders, schema, channel, message)


def _message(decoders: Any, schema: Any, channel: Any, message: Any) -> Any:
    """The decoded message; None where it cannot be."""
    try:
        decoder = decoders.decoder_for(channel.message_encoding, schema)
        return None if decoder is None else decoder(message.data)
    except Exception:  # whatever a crafted schema or message leads to
        return None


def _listed(path: Path, decoders: Any) -> dict[str, Any]:
    """By topic types, times of images, how many of them have which encoding that is not read, and poses; and why the
    file ends, if it breaks off."""
    types: dict[str, str] = {}
    walked: dict[str, str] = {}  # types of topics with poses
    images: dict[str, list[float]] = {}
    poses: dict[str, list[list[float | None]]] = {}
    latest: dict[str, float] = {}  # time of the last pose of each topic
    unread: dict[str, Counter[str]] = {}  # encodings of images that are not read, by topic
    broken: list[str] = []
    listed = 0
    for schema, channel, message in _messages(path, broken):
        name = "" if schema is None else schema.name
        if len(channel.topic) > LONGEST_TOPIC or (channel.topic not in types and len(types) == MOST_TOPICS):
            continue
        types[channel.topic] = name
        if name not in IMAGES and name not in POSES:
            continue
        if listed == MOST_LISTED:
            broken.append(f"it has more than {MOST_LISTED:,} images and poses")
            break
        listed += 1
        decoded = _message(decoders, schema, channel, message)
        time, pose = _time_and_pose(name, decoded, message)
        if name in IMAGES:
            images.setdefault(channel.topic, []).append(time)
            encoding = str(getattr(decoded, "encoding", next(iter(CODES))))[:40]
            others = unread.setdefault(channel.topic, Counter())
            if encoding not in CODES:
                others[encoding if encoding in others or len(others) < MOST_ENCODINGS else "others"] += 1
        elif decoded is not None and walked.setdefault(channel.topic, name) == name:
            rows = poses.setdefault(channel.topic, [])
            if pose is not None and abs(time - latest.get(channel.topic, -inf)) >= CLOSEST_S:
                rows.append([time, *pose])
                latest[channel.topic] = time
    return {
        "types": types | walked,
        "images": images,
        "unread": unread,
        "poses": poses,
        "broken": broken[0] if broken else None,
    }


def _time_and_pose(name: str, decoded: Any, message: Any) -> tuple[float, list[float | None] | None]:
    """Time and pose of a message; of one whose schema is not that of its type the time when it was logged."""
    try:
        return _time(decoded, message), _pose(name, decoded) if name in POSES and decoded is not None else None
    except (AttributeError, TypeError, OverflowError):
        return message.log_time * 1e-9, None


def _time(decoded: Any, message: Any) -> float:
    """Seconds: of the header where that is Unix time, else when the message was logged."""
    stamp = getattr(getattr(decoded, "header", None), "stamp", None)
    seconds = 0.0 if stamp is None else stamp.sec + stamp.nanosec * 1e-9
    return seconds if seconds >= LEAST_UNIX_S else message.log_time * 1e-9


def _pose(name: str, decoded: Any) -> list[float | None] | None:
    """x, y, z and heading, or latitude, longitude, altitude and None; None where there is none.

    The heading is that of the body's x axis, in degrees clockwise from +y (REP 103: x ahead, z up).
    """
    if name == "sensor_msgs/msg/NavSatFix":
        lat, lon, alt = decoded.latitude, decoded.longitude, decoded.altitude
        known = decoded.status.status >= 0 and abs(lat) <= 90 and abs(lon) <= 180
        return [lat, lon, alt if abs(alt) <= FARTHEST_M else None, None] if known else None
    pose = decoded.pose if name == "geometry_msgs/msg/PoseStamped" else decoded.pose.pose
    point, turn = pose.position, pose.orientation
    if not all(abs(metres) <= FARTHEST_M for metres in (point.x, point.y, point.z)):  # a filter that has diverged
        return None
    if not all(map(isfinite, (turn.x, turn.y, turn.z, turn.w))):
        return None
    # Of a quaternion of any length; of none, as of a node that leaves it out, there is no heading.
    ahead = (turn.w**2 + turn.x**2 - turn.y**2 - turn.z**2, 2 * (turn.x * turn.y + turn.w * turn.z))
    heading = whole_turn(degrees(atan2(ahead[0], ahead[1])) % 360) if max(map(abs, ahead)) > 1e-6 else None
    return [point.x, point.y, point.z, heading]


def _usable(cv2: Any, image: Any, max_bytes: int, max_pixels: int) -> bytes | None:
    """`_encoded`; None too where that fails, as of a frame of 0 x 0 pixels: the images after it are still to come."""
    try:
        return _encoded(cv2, image, max_bytes, max_pixels)
    except Exception:
        return None


def _encoded(cv2: Any, image: Any, max_bytes: int, max_pixels: int) -> bytes | None:
    """The bytes of an image, as they were recorded or as a JPEG; None where it cannot be used."""
    import numpy as np

    if image is None or len(image.data) > max(max_bytes, 4 * max_pixels):
        return None
    if not hasattr(image, "encoding"):
        return bytes(image.data)
    conversion, channels = CODES.get(image.encoding, (None, 0))
    if not channels or image.step < image.width * channels or len(image.data) < image.step * image.height:
        return None
    rows = np.frombuffer(bytes(image.data), np.uint8)[: image.step * image.height].reshape(image.height, image.step)
    pixels = rows[:, : image.width * channels].reshape(image.height, image.width, channels)
    if conversion is not None:
        pixels = cv2.cvtColor(pixels, getattr(cv2, f"COLOR_{conversion}"))
    made, jpeg = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return jpeg.tobytes() if made else None


if __name__ == "__main__":
    main(sys.argv[1:])
