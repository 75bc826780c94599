"""Messages of ROS from and to what the other modules compute with."""

from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose as PoseMessage, PoseWithCovarianceStamped, TransformStamped
from revisit_client.wire import QueryAnswer
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header, String

from revisit_ros.encoding import as_file, checked
from revisit_ros.frames import Transform, quaternion_of_yaw
from revisit_ros.health import Report
from revisit_ros.images import Shot
from revisit_ros.landmarks import Landmark
from revisit_ros.pose import Pose


def shot_of_compressed(message: CompressedImage, arrived: float) -> Shot:
    """A compressed image: its bytes are passed on as they are."""
    header = message.header
    return Shot(
        header.stamp.sec,
        header.stamp.nanosec,
        header.frame_id,
        lambda: checked(message.format, bytes(message.data)),
        arrived,
    )


def shot_of_raw(message: Image, arrived: float) -> Shot:
    """An image without compression."""
    header = message.header
    return Shot(
        header.stamp.sec,
        header.stamp.nanosec,
        header.frame_id,
        lambda: as_file(message.encoding, message.width, message.height, message.step, bytes(message.data)),
        arrived,
    )


def transform_of(message: TransformStamped) -> Transform:
    """Where the child frame lies; raises ValueError for numbers that are no transform."""
    t, q = message.transform.translation, message.transform.rotation
    return Transform(t.x, t.y, t.z, q.x, q.y, q.z, q.w)


def transform_message(transform: Transform, parent: str, child: str, stamp: Time) -> TransformStamped:
    """Where the child frame lies in its parent."""
    message = TransformStamped()
    message.header = Header(stamp=stamp, frame_id=parent)
    message.child_frame_id = child
    t, q = message.transform.translation, message.transform.rotation
    t.x, t.y, t.z = transform.x, transform.y, transform.z
    q.x, q.y, q.z, q.w = transform.qx, transform.qy, transform.qz, transform.qw
    return message


def pose_message(pose: Pose, shot: Shot, map_frame: str) -> PoseWithCovarianceStamped:
    """The pose at the stamp of the image."""
    message = PoseWithCovarianceStamped()
    message.header = _header(shot, map_frame)
    message.pose.pose = _level(pose)
    message.pose.covariance = pose.covariance()
    return message


def _level(pose: Pose) -> PoseMessage:
    message = PoseMessage()
    message.position.x, message.position.y, message.position.z = pose.position
    q = message.orientation
    q.x, q.y, q.z, q.w = quaternion_of_yaw(0.0 if pose.yaw is None else pose.yaw)
    return message


def place_message(place: str) -> String:
    """A name of a place."""
    return String(data=place)


def classification_message(kind: type[Any], hypothesis: type[Any], answer: QueryAnswer, shot: Shot) -> Any:
    """`vision_msgs/Classification`: the places of an answer that have names, each with its probability.

    Parameters
    ----------
    kind, hypothesis : type
        The classes of the message and of its results, which not every robot has.
    """
    message = kind()
    message.header = _header(shot, shot.frame)
    named = [place for place in answer.places if place.place is not None]
    message.results = [hypothesis(class_id=place.place, score=float(place.probability)) for place in named]
    return message


def landmark_message(kind: type[Any], landmark: Landmark, shot: Shot) -> Any:
    """`rtabmap_msgs/LandmarkDetection`: the landmark is where the camera is.

    Parameters
    ----------
    kind : type
        The message's class, which not every robot has.
    """
    message = kind()
    message.header = _header(shot, shot.frame)
    message.landmark_frame_id = ""
    message.id = landmark.id
    message.size = 0.0
    message.pose.pose.orientation.w = 1.0
    message.pose.covariance = landmark.covariance()
    return message


def diagnostics_message(name: str, hardware: str, report: Report, now: Time) -> DiagnosticArray:
    """One status; its level is a single byte in Python."""
    status = DiagnosticStatus()
    status.level = bytes([report.level])
    status.name, status.hardware_id, status.message = name, hardware, report.message
    status.values = [KeyValue(key=key, value=value) for key, value in report.values.items()]
    message = DiagnosticArray()
    message.header.stamp = now
    message.status = [status]
    return message


def _header(shot: Shot, frame: str) -> Header:
    return Header(stamp=Time(sec=shot.seconds, nanosec=shot.nanoseconds), frame_id=frame)
