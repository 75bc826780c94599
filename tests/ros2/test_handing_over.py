"""Poses are handed over once, to Nav2 or to Autoware, and again until somebody takes them."""

from collections.abc import Callable
from typing import Any

from tests.ros2.fake_rclpy import Graph
from tests.ros2.interfaces import made
from tests.ros2.test_nodes import STAMP, Service, matched, mount, send, trigger
from tests.ros2.test_nodes import service as service  # fixtures
from tests.ros2.test_nodes import start as start
from tests.sample_images import photo


def test_the_first_pose_becomes_the_initial_pose_once_somebody_listens(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("localize", hand_over="topic", rate=1e6)
    mount(graph)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert "nobody listens" in node.localizer.report().message
    heard: list[Any] = []
    node.create_subscription(made["geometry_msgs/PoseWithCovarianceStamped"], "initialpose", heard.append, 10)
    for second in range(1, 4):
        send(graph, photo(), second=second)
        graph.until(lambda: len(graph.published["/localize/pose"]) > second)  # noqa: B023
    assert [pose.header.stamp.sec for pose in heard] == [STAMP + 1]
    trigger(graph)
    send(graph, photo(), second=4)
    graph.until(lambda: len(heard) == 2)


def test_a_pose_of_unknown_radius_is_not_handed_over(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    node = start("localize", hand_over="topic")
    node.create_subscription(made["geometry_msgs/PoseWithCovarianceStamped"], "initialpose", lambda pose: None, 10)
    service.matched = matched(radius=None)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert graph.published["/initialpose"] == []


def test_nav2_is_called_and_waited_for_by_nobody(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    node = start("localize", hand_over="service", rate=1e6)
    kind = made["nav2_msgs/SetInitialPose"]
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert "amcl" in node.localizer.report().message
    hanging = graph.hanging["/set_initial_pose"] = []
    send(graph, photo(), second=1)
    graph.until(lambda: hanging)
    send(graph, photo(), second=2)  # the first call hangs: no second one
    graph.until(lambda: len(graph.published["/localize/pose"]) == 3)
    assert len(hanging) == 1
    trigger(graph)
    send(graph, photo(), second=3)  # but what a trigger wished for is handed over
    graph.until(lambda: len(hanging) == 2)
    node.values["timeout"] = 0.0
    graph.until(lambda: node._handed is None)  # given up
    node.values["timeout"] = 10.0
    called: list[Any] = graph.hanging.pop("/set_initial_pose")

    def take(request: Any, response: Any) -> Any:
        called.append(request)
        return response

    node.create_service(kind, "set_initial_pose", take)
    for second in (4, 5):
        send(graph, photo(), second=second)
        graph.until(lambda: len(graph.published["/localize/pose"]) == second + 1 and node._handed is None)  # noqa: B023
    assert [request.pose.header.stamp.sec - STAMP for request in called] == [1, 3, 4]


def test_autoware_gets_the_pose_as_a_guess_until_it_takes_it(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("localize", hand_over="autoware", rate=1e6)
    mount(graph)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert "pose_initializer" in node.localizer.report().message
    called: list[Any] = []

    def take(request: Any, response: Any) -> Any:
        called.append(request)
        moves = len(called) == 1
        response.status.success, response.status.code = not moves, int(moves)
        response.status.message = "The vehicle is not stopped." if moves else ""
        return response

    node.create_service(made["autoware_localization_msgs/InitializeLocalization"], "localization/initialize", take)
    for second in (1, 2, 3):
        send(graph, photo(), second=second)
        graph.until(lambda: len(graph.published["/localize/pose"]) == second + 1 and node._handed is None)  # noqa: B023
    assert [request.pose_with_covariance[0].header.stamp.sec - STAMP for request in called] == [1, 2]
    assert [(len(request.pose_with_covariance), request.method) for request in called] == [(1, 0), (1, 0)]
    assert any("not stopped" in line for level, line in graph.lines if level == "warning")
