"""What both nodes have in common: parameters, the image's topic, the client, transforms and /diagnostics."""

import importlib
import time
from collections.abc import Callable
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from revisit_client import ClientError, Revisit
from sensor_msgs.msg import CompressedImage, Image
from tf2_ros import Buffer, TransformException, TransformListener

from revisit_ros.frames import Transform
from revisit_ros.health import ERROR, OK, Report
from revisit_ros.images import Shot
from revisit_ros.messages import diagnostics_message, shot_of_compressed, shot_of_raw, transform_of
from revisit_ros.settings import BadParameter, Parameter, key_of, read

TELL_S = 1.0
"""Seconds between two messages on /diagnostics."""

ALIVE_S = 2.0
"""Seconds after its stamp that a moving transform counts as published."""


class RevisitNode(Node):
    """A node that sends images to a service and never waits for it in the executor.

    Parameters
    ----------
    name : str
    parameters : tuple of Parameter

    Raises
    ------
    BadParameter
        A parameter, a key, or a package of messages that cannot be used.
    """

    def __init__(self, name: str, parameters: tuple[Parameter, ...]) -> None:
        super().__init__(name)
        self.values = read(parameters, {parameter.name: self._declared(parameter) for parameter in parameters})
        try:
            self.revisit = Revisit(
                self.values["url"] or None, key=key_of(self.values), timeout=self.values["timeout"], patience=0
            )
        except ClientError as error:  # of the address, the key, or a proxy that the environment names
            raise BadParameter(str(error)) from None
        self.clock = time.monotonic
        self._buffer = Buffer()
        self._listener = TransformListener(self._buffer, self)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._state = "starting"

    def _declared(self, parameter: Parameter) -> Any:
        """What a parameter was given at the start; its type is ours to judge, and it does not change afterwards."""
        about = ParameterDescriptor(description=parameter.description, dynamic_typing=True, read_only=True)
        return self.declare_parameter(parameter.name, parameter.default, about).value

    def listen(self, take: Callable[[Shot], None]) -> None:
        """Subscribe to the images."""
        if self.values["image_transport"] == "compressed":
            kind, topic, shot_of = CompressedImage, "image/compressed", shot_of_compressed
        else:
            kind, topic, shot_of = Image, "image", shot_of_raw
        self.values["topic"] = self.resolve_topic_name(topic)
        self._images = self.create_subscription(
            kind, topic, lambda message: take(shot_of(message, self.clock())), qos_profile_sensor_data
        )

    def placed(self, shot: Shot, target: str, frame: str = "") -> Transform | None:
        """The camera of an image, or another frame, in a frame when the image was taken; None while that is not known.

        Never waits.
        """
        stamp = Time(seconds=shot.seconds, nanoseconds=shot.nanoseconds, clock_type=self.get_clock().clock_type)
        frame = frame or shot.frame
        try:
            return transform_of(self._buffer.lookup_transform(target, frame, stamp))
        except (TransformException, ValueError) as error:
            self.get_logger().debug(f"no transform from {frame} to {target}: {error}")
            return None

    def is_placed_now(self, target: str, frame: str) -> bool:
        """Whether somebody publishes where a frame is: for good, or within the last seconds."""
        clock = self.get_clock()
        try:
            stamp = self._buffer.lookup_transform(target, frame, Time(clock_type=clock.clock_type)).header.stamp
        except TransformException:
            return False
        age_s = clock.now().nanoseconds / 1e9 - stamp.sec - stamp.nanosec / 1e9
        return bool(age_s < ALIVE_S or stamp.sec == stamp.nanosec == 0)

    def ahead(self, seconds: float) -> Any:
        """The time of the node's clock in so many seconds, as messages have it."""
        clock = self.get_clock()
        nanoseconds = clock.now().nanoseconds + round(seconds * 1e9)
        return Time(nanoseconds=nanoseconds, clock_type=clock.clock_type).to_msg()

    def tell(self, report: Report) -> None:
        """Publish a status, and log it where it is another than before."""
        name = f"{self.get_fully_qualified_name()}: visual localization"
        now = self.get_clock().now().to_msg()
        self._diagnostics.publish(diagnostics_message(name, self.revisit.url, report, now))
        state = report.values["state"]
        if state == self._state:
            return
        self._state = state
        line = "; ".join(filter(None, (f"{state}: {report.message}", report.values.get("remedy", ""))))
        if report.level == OK:
            self.get_logger().info(line)
        elif report.level == ERROR:
            self.get_logger().error(line)
        else:
            self.get_logger().warning(line)


def message_type(package: str, kind: str, name: str, why: str) -> Any:
    """A type of a package that only some robots have.

    Raises
    ------
    BadParameter
    """
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (ImportError, AttributeError) as error:
        debian = package.replace("_", "-")
        raise BadParameter(f"{why} needs {package}: apt install ros-$ROS_DISTRO-{debian} ({error})") from None


def run(make: Callable[[], Any]) -> int:
    """Spin a node until it is stopped; its `close` is called. The exit code."""
    rclpy.init()
    node = None
    try:
        node = make()
        rclpy.spin(node)
    except BadParameter as error:
        get_logger("revisit_ros").fatal(str(error))
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node is not None:
            node.close()
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
