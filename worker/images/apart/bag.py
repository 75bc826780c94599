"""Recordings of ROS 2 in MCAP files: images and poses by topic, read in a process of its own."""

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from schemas.errors import BadBody
from worker.images.apart.bag_child import CODES, POSES
from worker.images.apart.stream import Ended, ImageStream
from worker.images.codec import Limits

MAGIC = b"\x89MCAP0\r\n"

READ = ", ".join(CODES)
"""Encodings of images without compression."""

PoseRow = list[float | None]
"""Time in seconds, then x, y, z and heading, or latitude, longitude, altitude and None."""


AIMS = frozenset({"goal_pose", "goal", "goal_update", "initialpose"})
"""Names of topics of RViz and Nav2 whose poses say where the robot is to go, or where somebody takes it to be."""


class Bag(ImageStream):
    """The images of one topic, as they were recorded, and poses.

    Parameters
    ----------
    path : Path
    limits : Limits
        Of the size of an image.
    image_topic, pose_topic : str or None
        None: the only one; of several topics with poses, the one of the best type by the order of `bag_child.POSES`,
        if it has any, and none of `AIMS`.
    listing : Path or None
        As `kept` of `ImageStream.listed`.

    Attributes
    ----------
    topic : str
    times_s : list of float
        When the images were taken, Unix time, in the order of the file.
    pose_topic : str or None
        Topic of the poses.
    poses : list of PoseRow
    geographic : bool
        Whether the poses are latitudes and longitudes.
    unread : str
        How many images have which encoding that is not read; empty where all are read.
    broken : str or None
        Why the file cannot be read to its end.

    Raises
    ------
    BadBody
    """

    def __init__(
        self,
        path: Path,
        limits: Limits,
        image_topic: str | None,
        pose_topic: str | None,
        listing: Path | None = None,
    ) -> None:
        if find_spec("mcap_ros2") is None:
            raise BadBody(
                "malformed-body",
                "this service reads no MCAP files: whoever runs it can add that by pip install mcap mcap-ros2-support",
            )
        child = "worker.images.apart.bag_child"
        stream = ImageStream(child, path, "", limits.max_bytes, limits.max_pixels)
        try:
            known = stream.listed(listing)
        except Ended as error:
            raise _refused(str(error)) from None
        images, poses, types = known["images"], known["poses"], known["types"]
        if not images:
            there = ", ".join(f"{topic} ({kind or 'no schema'})" for topic, kind in sorted(types.items())[:20])
            broken = f"; it breaks off: {known['broken']}" if known["broken"] else ""
            raise _refused(
                f"it holds no images of ROS 2 (sensor_msgs/msg/CompressedImage, Image){broken}; topics: {there}"
            )
        self.topic = _chosen("image_topic", image_topic, list(images))
        unread: dict[str, int] = known.get("unread", {}).get(self.topic, {})  # listings of earlier versions have none
        self.unread = ", ".join(f"{count:,} {encoding}" for encoding, count in unread.items())
        if sum(unread.values()) == len(images[self.topic]):
            raise _refused(f"no image of {self.topic} has an encoding that is read, {READ}; it has {self.unread}")
        super().__init__(child, path, self.topic, limits.max_bytes, limits.max_pixels)
        self.times_s: list[float] = images[self.topic]
        self.broken: str | None = known["broken"]
        self.pose_topic = (
            _pose_topic(poses, types) if pose_topic is None else _chosen("pose_topic", pose_topic, list(poses))
        )
        self.poses: list[PoseRow] = [] if self.pose_topic is None else poses[self.pose_topic]
        self.geographic = self.pose_topic is not None and types[self.pose_topic] == "sensor_msgs/msg/NavSatFix"


def _pose_topic(poses: Mapping[str, Sequence[PoseRow]], types: Mapping[str, str]) -> str | None:
    """The topic with the poses of the robot; None where there is none. Raises BadBody where several will do."""
    of_robot = [topic for topic in poses if topic.rpartition("/")[2] not in AIMS]
    topics = [topic for topic in of_robot if poses[topic]] or of_robot
    best = min((POSES.index(types[topic]) for topic in topics), default=0)
    found = [topic for topic in topics if types[topic] == POSES[best]]
    return _chosen("pose_topic", None, found) if found else None


def _chosen(parameter: str, wanted: str | None, topics: list[str]) -> str:
    """The wanted one of some topics, or the only one; raises BadBody, which names the parameter and the topics."""
    if wanted is None and len(topics) == 1:
        return topics[0]
    if wanted in topics:
        return wanted
    why = f"it has no such topic as {wanted!r}" if wanted else "several of its topics will do"
    raise _refused(f"{why}: say {parameter}= one of {', '.join(sorted(topics)) or 'none'}")


def _refused(why: str) -> BadBody:
    return BadBody("malformed-body", f"the MCAP file is refused: {why}")
