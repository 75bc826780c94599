"""The node localize publishes the transform from map to odom, where it is told to, and tells why where it does not."""

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.ros2.fake_rclpy import Graph
from tests.ros2.fake_tf2 import Matrix, as_matrix, as_message
from tests.ros2.interfaces import message
from tests.ros2.serving import STAMP, Service, matched, mount, send
from tests.sample_images import photo


def placed(x: float, y: float, yaw: float) -> Matrix:
    """A level frame."""
    made = np.eye(4)
    made[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    made[:2, 3] = x, y
    return made


def tell(graph: Graph, where: Matrix, parent: str, child: str, stamp: float) -> None:
    """A moving transform."""
    told = message("tf2_msgs/TFMessage", transforms=[as_message(where, parent, child, round(stamp * 10**9))])
    graph.publish("/tf", type(told), told, "reliable")


def sent(graph: Graph) -> list[Any]:
    """What was published of where odom is in the map."""
    all_of_them = [one for told in graph.published["/tf"] for one in told.transforms]
    return [one for one in all_of_them if (one.header.frame_id, one.child_frame_id) == ("map", "odom")]


def noted(node: Any) -> str:
    report = node._correction.added_to(node.localizer.report(), node.clock())
    return str(report.message)


def test_odometry_is_put_where_the_photo_was_taken_when_it_was_taken(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    """The answer places the base at (10, 4.7), facing north, at 0.25 s; odometry had it at (4, 0) then, facing east,
    and has it elsewhere by now. So odom lies 4 m south of there, turned left."""
    start("localize", publish_tf=True, transform_tolerance=0.5, transform_rate=50)
    mount(graph)
    for second, x in ((0, 3.0), (1, 7.0), (2, 50.0)):
        tell(graph, placed(x, 0, 0), "odom", "base_link", STAMP + second)
    before = time.time()
    send(graph, photo())
    graph.until(lambda: len(sent(graph)) >= 5)  # it goes on
    first, last = sent(graph)[0], sent(graph)[-1]
    assert as_matrix(first) == pytest.approx(placed(10, 0.7, math.pi / 2), abs=1e-6)
    assert as_matrix(last) == pytest.approx(as_matrix(first))
    stamps = [one.header.stamp.sec + one.header.stamp.nanosec / 1e9 for one in (first, last)]
    assert before + 0.5 <= stamps[0] < stamps[1] <= time.time() + 0.5

    # TF, as the robot's other nodes have it, places the base where the service said.
    tf = as_matrix(last) @ placed(4, 0, 0)
    pose = graph.published["/localize/pose"][0].pose.pose.position
    assert (tf[0, 3], tf[1, 3]) == pytest.approx((pose.x, pose.y))


def test_nothing_is_published_unless_it_is_told_to(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    start("localize")
    mount(graph)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP + 1)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert sent(graph) == []
    assert "map_to_odom" not in {value.key for one in graph.published["/diagnostics"] for value in one.status[0].values}


def test_what_does_not_match_changes_nothing(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    node = start("localize", publish_tf=True, rate=1e6)
    mount(graph)
    for second in range(3):
        tell(graph, placed(10.0 * second, 0, 0), "odom", "base_link", STAMP + second)
    service.matched = matched("ambiguous", x=0.0, y=0.0, z=1.2, heading=90.0)
    send(graph, photo())
    graph.until(lambda: node.localizer.report().values["ambiguous"] == "1")
    assert sent(graph) == []
    assert "no match has given one yet" in noted(node)
    service.matched = matched()
    send(graph, photo())
    graph.until(lambda: sent(graph))
    service.matched = matched("no_match", x=0.0, y=0.0, z=1.2, heading=90.0)
    send(graph, photo(), second=1)
    graph.until(lambda: node.localizer.report().values["no_match"] == "1")
    count = len(sent(graph))
    graph.until(lambda: len(sent(graph)) > count + 2)
    assert as_matrix(sent(graph)[-1]) == pytest.approx(as_matrix(sent(graph)[0]))  # held: odometry carries on
    service.matched = matched()
    send(graph, photo(), second=1)
    graph.until(lambda: as_matrix(sent(graph)[-1])[1, 3] == pytest.approx(4.7 - 12.5))


def test_without_a_heading_nothing_is_published_and_diagnostics_say_so(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    start("localize", publish_tf=True)
    service.matched = matched(x=10.0, y=5.0, z=1.2)
    mount(graph)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP + 1)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    graph.published["/diagnostics"].clear()
    graph.until(lambda: graph.published["/diagnostics"])
    (told,) = graph.published["/diagnostics"][-1].status
    assert told.level == b"\1"
    assert "no map to odom: the pose has no heading" in told.message
    assert {value.key: value.value for value in told.values}["map_to_odom"] == "no match yet"
    assert sent(graph) == []


def test_odometry_that_comes_late_is_waited_for_and_told_where_it_never_comes(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("localize", publish_tf=True, rate=1e6)
    mount(graph)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert sent(graph) == []
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP + 1)
    graph.until(lambda: sent(graph))
    assert noted(node) == "last answer: matched"
    send(graph, photo(), second=7)
    graph.until(lambda: "TF does not place 'base_link' in 'odom'" in noted(node))


def test_two_never_publish_the_same_transform(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    """AMCL runs too: the first of both stays. Once it has ended, the node takes over."""
    node = start("localize", publish_tf=True, rate=1e6)
    mount(graph)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP + 9)
    tell(graph, placed(1, 1, 0), "map", "odom", time.time() + 3600)
    send(graph, photo())
    graph.until(lambda: "somebody else publishes where 'odom' is in 'map'" in noted(node))
    assert len(sent(graph)) == 1
    node._buffer.moving["odom"] = {round((time.time() - 5) * 10**9): ("map", placed(1, 1, 0))}  # it ended 5 s ago
    send(graph, photo(), second=1)
    graph.until(lambda: len(sent(graph)) > 1)
    assert noted(node) == "last answer: matched"


def test_it_ends_so_long_after_the_last_match(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    node = start("localize", publish_tf=True, transform_hold=30, rate=1e6)
    mount(graph)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP)
    tell(graph, placed(0, 0, 0), "odom", "base_link", STAMP + 9)
    send(graph, photo())
    graph.until(lambda: len(sent(graph)) > 2)
    now = node.clock
    node.clock = lambda: now() + 31
    graph.spin_once()
    count = len(sent(graph))
    for _ in range(5):
        graph.spin_once()
    assert len(sent(graph)) == count
    assert "older than transform_hold (30 s)" in noted(node)
    node.clock = now
    send(graph, photo(), second=1)
    graph.until(lambda: len(sent(graph)) > count)
    assert noted(node) == "last answer: matched"
