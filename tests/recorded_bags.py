"""MCAP files as a robot with ROS 2 records them, for tests."""

import io
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import pytest

HEADER = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
POSE = """
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
SCHEMAS = {
    "sensor_msgs/msg/CompressedImage": "std_msgs/Header header\nstring format\nuint8[] data" + HEADER,
    "sensor_msgs/msg/Image": "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
    "uint8 is_bigendian\nuint32 step\nuint8[] data" + HEADER,
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose" + HEADER + POSE,
    "nav_msgs/msg/Odometry": "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose"
    + HEADER
    + "=" * 80
    + "\nMSG: geometry_msgs/PoseWithCovariance\ngeometry_msgs/Pose pose\nfloat64[36] covariance"
    + POSE,
    "sensor_msgs/msg/NavSatFix": "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\n"
    "float64 longitude\nfloat64 altitude"
    + HEADER
    + "=" * 80
    + "\nMSG: sensor_msgs/NavSatStatus\nint8 status\nuint16 service",
    "std_msgs/msg/String": "string data",
}
"""Definitions by type; the tail of some, which nothing here reads, is left out."""

START = 1_767_225_600.0

Message = tuple[str, str, float, dict[str, Any]]
"""Topic, type, seconds from `START`, and fields besides the header."""


def bag(messages: Iterable[Message], compression: str = "ZSTD") -> bytes:
    """The bytes of a file with these messages."""
    writing = pytest.importorskip("mcap_ros2.writer", reason="NO MCAP FILE IS READ: the extra `mcap` is not installed")
    from mcap.writer import CompressionType

    out = io.BytesIO()
    writer = writing.Writer(out, chunk_size=20_000, compression=CompressionType[compression])
    known = {name: writer.register_msgdef(name, text) for name, text in SCHEMAS.items()}
    for topic, kind, seconds, fields in messages:
        time = START + seconds
        stamp = SimpleNamespace(sec=int(time), nanosec=round(time % 1 * 1e9))
        message = {"header": SimpleNamespace(stamp=stamp, frame_id="base_link"), **fields}
        writer.write_message(topic, known[kind], SimpleNamespace(**message), log_time=round(time * 1e9))
    writer.finish()
    return out.getvalue()


def image(seconds: float, data: bytes, topic: str = "/camera/compressed") -> Message:
    return topic, "sensor_msgs/msg/CompressedImage", seconds, {"format": "jpeg", "data": data}


def at(x: float, y: float, yaw: tuple[float, float] = (0.0, 1.0)) -> SimpleNamespace:
    """A pose on the ground; `yaw` is z and w of its quaternion."""
    point = SimpleNamespace(x=x, y=y, z=0.0)
    return SimpleNamespace(position=point, orientation=SimpleNamespace(x=0.0, y=0.0, z=yaw[0], w=yaw[1]))


def pose(seconds: float, x: float, y: float, topic: str = "/pose") -> Message:
    return topic, "geometry_msgs/msg/PoseStamped", seconds, {"pose": at(x, y)}


def odometry(seconds: float, x: float, y: float, topic: str = "/odom") -> Message:
    told = SimpleNamespace(pose=at(x, y), covariance=[0.0] * 36)
    return topic, "nav_msgs/msg/Odometry", seconds, {"child_frame_id": "base_link", "pose": told}


def fix(seconds: float, lat: float, lon: float, status: int = 0) -> Message:
    told = SimpleNamespace(status=status, service=1)
    fields = {"status": told, "latitude": lat, "longitude": lon, "altitude": 12.0}
    return "/fix", "sensor_msgs/msg/NavSatFix", seconds, fields
