"""The layer of rclpy: topics, types, stamps, parameters, hand-overs; what it computes is tested elsewhere."""

import importlib
import math
import re
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from app.http.examples import QUERY_ANSWER
from tests.ros2.fake_rclpy import BEST_EFFORT, Graph
from tests.ros2.interfaces import message
from tests.ros2.serving import STAMP, Service, matched, mount, send, trigger, walk
from tests.sample_images import photo


def test_a_pose_has_the_stamp_of_its_image_and_the_covariance_of_its_radius(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    start("localize", map_frame="site")
    mount(graph)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    (pose,) = graph.published["/localize/pose"]
    assert (pose.header.frame_id, pose.header.stamp.sec, pose.header.stamp.nanosec) == ("site", STAMP, 250_000_000)
    at, turned = pose.pose.pose.position, pose.pose.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx((10, 4.7, 0))
    assert (turned.x, turned.y, turned.z, turned.w) == pytest.approx((0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    assert np.diag(pose.pose.covariance.reshape(6, 6)) == pytest.approx([8, 8, 8, 9999, 9999, math.radians(20) ** 2])
    assert photo() in service.bodies[0]  # as it came, byte for byte
    assert graph.published["/localize/place"][0].data == QUERY_ANSWER["places"][0]["place"]


def test_nothing_is_published_of_what_did_not_match(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    node = start("localize", landmarks=True, hand_over="topic")
    service.matched = matched("ambiguous")
    send(graph, photo())
    graph.until(lambda: node.localizer.report().values["ambiguous"] == "1")
    graph.until(lambda: graph.published["/diagnostics"])
    assert {topic for topic, sent in graph.published.items() if sent} == {"/image/compressed", "/diagnostics"}


def test_images_without_compression_are_taken(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    start("localize", image_transport="raw")
    image = message("sensor_msgs/Image", width=2, height=1, step=8, encoding="rgb8", data=bytes(range(8)))
    graph.publish("/image", type(image), image, BEST_EFFORT)
    graph.until(lambda: graph.published["/localize/pose"])
    assert b"BM" in service.bodies[0]
    assert bytes([2, 1, 0, 5, 4, 3, 0, 0]) in service.bodies[0]


def status(graph: Graph) -> Any:
    """The latest status, with its values as a dict."""
    (one,) = graph.published["/diagnostics"][-1].status
    return one, {value.key: value.value for value in one.values}


def test_sixteen_bits_are_refused_and_told_on_diagnostics(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("localize", image_transport="raw")
    image = message("sensor_msgs/Image", width=2, height=1, step=4, encoding="mono16", data=bytes(4))
    graph.publish("/image", type(image), image, BEST_EFFORT)
    graph.until(lambda: node.localizer.report().values["state"] == "image refused")
    graph.published["/diagnostics"].clear()
    graph.until(lambda: graph.published["/diagnostics"])
    told, values = status(graph)
    assert (told.level, told.name, told.hardware_id) == (
        b"\1",
        "/localize: visual localization",
        "http://127.0.0.1:8000",
    )
    assert "mono16" in told.message
    assert values["queries_failed"] == "1"
    assert service.bodies == []
    assert any(level == "warning" and "mono16" in line for level, line in graph.lines)


def test_without_the_cameras_mount_the_pose_is_the_cameras_and_diagnostics_say_so(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("localize")
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert graph.published["/localize/pose"][0].pose.pose.position.y == pytest.approx(5)
    report = node.localizer.report()
    assert (report.level, "the pose is the camera's ('camera' in 'base_link')" in report.message) == (1, True)


def test_a_map_in_degrees_gives_no_pose_and_says_why(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    node = start("localize")
    service.matched = matched(lat=50.0, lon=14.0)
    send(graph, photo())
    graph.until(lambda: "degrees" in node.localizer.report().message)
    assert graph.published["/localize/pose"] == []


def test_the_trigger_asks_once(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    start("localize", rate=0)
    send(graph, photo(1))
    graph.spin_once()
    assert trigger(graph).success is True
    send(graph, photo(2))
    graph.until(lambda: graph.published["/localize/pose"])
    assert [photo(2) in body for body in service.bodies] == [True]


def hint(graph: Graph, frame: str = "map", variance: float = 100.0) -> None:
    told = message("geometry_msgs/PoseWithCovarianceStamped")
    told.header.frame_id = frame
    told.pose.pose.position.x = 7.0
    told.pose.covariance[0] = told.pose.covariance[7] = variance
    graph.publish("/visual_localization/trigger_localization", type(told), told, "reliable")


def test_a_pose_on_the_triggers_topic_is_where_it_searches(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    start("localize", rate=0, use_initial_guess=True)
    hint(graph)
    graph.spin_once()
    send(graph, photo())
    graph.until(lambda: service.bodies)
    assert b"7.0,0.0,30.0" in service.bodies[0]


@pytest.mark.parametrize(("frame", "variance", "told"), [("odom", 1.0, "'odom'"), ("map", -1.0, "negative")])
def test_a_hint_that_is_none_is_told_and_not_used(
    frame: str, variance: float, told: str, graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("localize", rate=0, use_initial_guess=True)
    mount(graph)
    hint(graph, frame, variance)
    graph.until(lambda: told in node.localizer.note)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/pose"])
    assert b'name="near"' not in service.bodies[0]
    assert told in node.localizer.report().message


def test_places_are_classes_with_their_probabilities(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    start("localize", classification="true", rate=1e6)
    send(graph, photo())
    graph.until(lambda: graph.published["/localize/classification"])
    (seen,) = graph.published["/localize/classification"]
    assert (seen.header.frame_id, seen.header.stamp.sec) == ("camera", STAMP)
    told = {place["place"]: place["probability"] for place in QUERY_ANSWER["places"] if place["place"] is not None}
    assert told
    assert {one.class_id: one.score for one in seen.results} == told
    service.matched = matched("ambiguous")
    send(graph, photo(), second=1)
    graph.until(lambda: len(service.bodies) == 2)
    assert len(graph.published["/localize/classification"]) == 1


def test_a_place_is_a_landmark_where_the_camera_is(graph: Graph, service: Service, start: Callable[..., Any]) -> None:
    start("localize", landmarks="true")
    send(graph, photo())
    graph.until(lambda: graph.published["/landmark_detection"])
    (seen,) = graph.published["/landmark_detection"]
    assert (seen.header.frame_id, seen.header.stamp.sec) == ("camera", STAMP)
    assert seen.id > 0
    assert seen.pose.pose.orientation.w == 1
    assert np.diag(seen.pose.covariance.reshape(6, 6)) == pytest.approx([8, 8, 8, 9999, 9999, 9999])


@pytest.mark.parametrize(
    ("package", "parameter", "told"),
    [
        ("nav2_msgs.srv", {"hand_over": "service"}, "apt install ros-$ROS_DISTRO-nav2-msgs"),
        ("rtabmap_msgs.msg", {"landmarks": True}, "apt install ros-$ROS_DISTRO-rtabmap-msgs"),
        ("vision_msgs.msg", {"classification": True}, "apt install ros-$ROS_DISTRO-vision-msgs"),
        (
            "autoware_localization_msgs.srv",
            {"hand_over": "autoware"},
            "apt install ros-$ROS_DISTRO-autoware-localization-msgs",
        ),
    ],
)
def test_a_missing_package_is_named_at_the_start(
    package: str,
    parameter: dict[str, Any],
    told: str,
    graph: Graph,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    graph.parameters["localize"] = parameter
    from revisit_ros import localize_node

    with pytest.raises(SystemExit) as ended:
        localize_node.main()
    assert ended.value.code == 2
    assert any(level == "fatal" and told in line for level, line in graph.lines)


def test_a_parameter_that_cannot_be_used_ends_the_node_with_its_name(graph: Graph) -> None:
    graph.parameters["enroll"] = {"every_metres": -1, "key": "not a key"}
    from revisit_ros import enroll_node

    with pytest.raises(SystemExit):
        enroll_node.main()
    assert any(level == "fatal" and "every_metres is -1" in line for level, line in graph.lines)
    graph.parameters["enroll"] = {"key": "not a key"}
    with pytest.raises(SystemExit):
        enroll_node.main()
    assert any(level == "fatal" and line.startswith("the key has letters") for level, line in graph.lines)


def test_an_address_or_a_proxy_that_is_none_ends_the_node_in_words(
    graph: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    enroll_node = importlib.import_module("revisit_ros.enroll_node")  # anew: the package keeps that of another test

    def ended(url: str) -> str:
        graph.parameters["enroll"] = {"url": url}
        with pytest.raises(SystemExit) as end:
            enroll_node.main()
        assert end.value.code == 2
        return graph.lines[-1][1]

    assert ended("robot:8000").startswith("'robot:8000' is no address of a service")
    monkeypatch.setenv("HTTP_PROXY", "what://proxy")
    assert re.match("HTTP_PROXY.* cannot be used", ended("http://robot:8000"))


def test_images_are_enrolled_where_the_camera_was_when_they_were_taken(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("enroll", landmarks=True, tf_wait=5)
    mount(graph)
    walk(graph, 0.0, 0)
    send(graph, photo())  # at 0.25 s: the transform comes later than the image
    for _ in range(3):
        graph.spin_once(0.01)
    assert service.bodies == []
    walk(graph, 4.0, 1)
    graph.until(lambda: graph.published["/landmark_detection"])
    body = service.bodies[0].decode(errors="replace")
    from tests.ros2.test_localizer import field

    # A quarter of the way from 0 to 4, and the camera 0.3 m ahead of the base; it looks east.
    at = [float(field(body, name) or "nan") for name in ("x", "y", "z", "heading")]
    assert at == pytest.approx([1.3, 0, 1.2, 90])
    assert graph.published["/landmark_detection"][0].header.stamp.nanosec == 250_000_000
    assert node.enroller.report().values["enrolled"] == "1"


def test_without_transforms_nothing_is_enrolled_and_diagnostics_say_why(
    graph: Graph, service: Service, start: Callable[..., Any]
) -> None:
    node = start("enroll", tf_wait=0)
    send(graph, photo())
    graph.until(lambda: node.enroller.report().values["images_without_transform"] == "1")
    assert "no transform from 'camera' to 'map'" in node.enroller.report().message
    assert service.bodies == []


def test_parameters_of_the_node_are_those_of_the_table(graph: Graph, start: Callable[..., Any]) -> None:
    from revisit_ros.settings import ENROLL, LOCALIZE

    assert start("localize").fake_declared == {parameter.name for parameter in LOCALIZE}
    assert start("enroll").fake_declared == {parameter.name for parameter in ENROLL}
