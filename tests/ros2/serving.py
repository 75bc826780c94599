"""What the tests of nodes share: a stand-in for the service, and what cameras and robots publish."""

from typing import Any

import httpx
import numpy as np

from app.http.examples import QUERY_ANSWER
from tests.answers import enrolled, view
from tests.ros2.fake_rclpy import BEST_EFFORT, Graph
from tests.ros2.fake_tf2 import as_message
from tests.ros2.interfaces import made, message

STAMP = 1_800_000_000
OPTICAL = np.array([[0.0, 0, 1, 0.3], [-1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])
"""An optical frame 0.3 m ahead of the base and 1.2 m above it, which looks ahead."""


class Service:
    """In place of the service: answers of `answer`, and what was sent."""

    def __init__(self) -> None:
        self.bodies: list[bytes] = []
        self.matched: dict[str, Any] = matched()

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.bodies.append(request.read())
        return httpx.Response(200, json=self.matched if request.url.path == "/query" else enrolled())


def matched(status: str = "matched", radius: float | None = 4.0, **where: float) -> dict[str, Any]:
    """An answer; the camera looks north unless said otherwise."""
    given = where or {"x": 10.0, "y": 5.0, "z": 1.2, "heading": 0.0}
    first = QUERY_ANSWER["matches"][0] | {"view": view(position=given)}
    estimate: dict[str, Any] = {
        "position": {k: v for k, v in given.items() if k != "heading"},
        "radius_m": radius,
        "views": [],
    }
    return {**QUERY_ANSWER, "status": status, "matches": [first], "estimate": estimate}


def send(graph: Graph, data: bytes, topic: str = "/image/compressed", second: int = 0, frame: str = "camera") -> None:
    """A compressed image, as drivers publish it."""
    image = message("sensor_msgs/CompressedImage", format="jpeg", data=data)
    image.header.frame_id = frame
    image.header.stamp.sec, image.header.stamp.nanosec = STAMP + second, 250_000_000
    graph.publish(topic, type(image), image, BEST_EFFORT)


def mount(graph: Graph) -> None:
    """The camera on the robot, as robot_state_publisher tells it."""
    told = message("tf2_msgs/TFMessage", transforms=[as_message(OPTICAL, "base_link", "camera")])
    graph.publish("/tf_static", type(told), told, "reliable")


def walk(graph: Graph, x: float, second: int) -> None:
    """Where odometry has the robot at a second: at x, facing east."""
    base = np.eye(4)
    base[0, 3] = x
    told = message("tf2_msgs/TFMessage", transforms=[as_message(base, "map", "base_link", (STAMP + second) * 10**9)])
    graph.publish("/tf", type(told), told, "reliable")


def trigger(graph: Graph) -> Any:
    kind = made["std_srvs/Trigger"]
    future = graph.call("/visual_localization/trigger_localization", kind.Request())
    graph.until(future.result)
    return future.result()
