"""A robot teaches a map by ROS 2, and finds itself in it; the service hangs, dies, comes back, and asks for keys."""

import importlib
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from revisit_client import Revisit

from scenes import scene
from tests.ros2.conftest import graph as graph  # a fixture
from tests.ros2.fake_rclpy import Graph
from tests.ros2.serving import STAMP, mount, send, trigger, walk
from tests.stories.photos import photo
from tests.stories.running import RunningService
from tests.stories.test_keys_are_made_and_revoked_while_it_runs import keys

pytestmark = pytest.mark.one_database("a node speaks HTTP, as the client does")

NAMES = ("mill lane", "the green", "school hill", "chapel row", "the quay", "north gate")


def started(graph: Graph, name: str, **parameters: Any) -> Any:
    graph.parameters[name] = parameters
    module = importlib.import_module(f"revisit_ros.{name}_node")
    node = (module.LocalizeNode if name == "localize" else module.EnrollNode)()
    mount(graph)
    return node


def told(graph: Graph) -> dict[str, str]:
    """The values of the latest status, with its level."""
    if not graph.published["/diagnostics"]:
        return {"state": "starting"}
    (status,) = graph.published["/diagnostics"][-1].status
    return {value.key: value.value for value in status.values} | {"level": str(status.level[0])}


def filming(graph: Graph, image: bytes, true: Callable[[], bool], seconds: float = 120) -> None:
    """A camera that publishes ten images a second, as of STAMP + 100 s, until something holds."""
    end, second = time.monotonic() + seconds, 100
    while not true():
        assert time.monotonic() < end, told(graph)
        send(graph, image, second=second)
        second += 1
        graph.spin_once(0.1)


def test_images_in_poses_out_whatever_becomes_of_the_service(graph: Graph, tmp_path: Path) -> None:
    here = photo(scene("chapel row").seen_from(dx=0.3, turn=2))
    poses = graph.published["/localize/pose"]
    with RunningService(tmp_path) as service:
        port = service.url.rpartition(":")[2]
        enroll = started(graph, "enroll", url=service.url, map="town", rate=1e6, timeout=60)
        for number, name in enumerate(NAMES):
            walk(graph, 10.0 * number, 2 * number)
            walk(graph, 10.0 * number, 2 * number + 1)
            send(graph, photo(scene(name).seen_from()), second=2 * number)
        graph.until(lambda: enroll.enroller.report().values["enrolled"] == "6", 120)
        enroll.close()
        enroll.destroy_node()

        with Revisit(service.url) as revisit:
            views = list(revisit.views("town"))
            positions = [(view.position.x, view.position.heading) for view in views if view.position]
            # The camera is 0.3 m ahead of a robot that faces east.
            assert positions == [pytest.approx((10 * number + 0.3, 90)) for number in range(6)]
            for view, name in zip(views, NAMES, strict=True):
                revisit.patch(view.id, place=name)

        localize = started(graph, "localize", url=service.url, map="town", rate=1e6, timeout=3, max_age=60)
        filming(graph, here, lambda: len(poses) > 0)
        assert graph.published["/localize/place"][0].data == "chapel row"
        assert poses[0].header.frame_id == "map"
        assert poses[0].header.stamp.sec >= STAMP + 100
        at, turned = poses[0].pose.pose.position, poses[0].pose.pose.orientation
        assert [at.x, at.y] == pytest.approx([30, 0], abs=5)
        assert [turned.z, turned.w] == pytest.approx([0, 1], abs=1e-6)
        variances = np.diag(poses[0].pose.covariance.reshape(6, 6))
        assert 1 < variances[0] == variances[1] < 1000
        assert list(variances[3:5]) == [9999, 9999]

        # It hangs: the executor goes on, the newest image waits, and the call ends by its time limit.
        service.signal(signal.SIGSTOP)
        graph.longest_s = 0.0
        before = int(localize.localizer.report().values["images_dropped"])
        filming(graph, here, lambda: told(graph)["state"] == "service away")
        assert graph.longest_s < 2  # and not the 3 s of a call
        assert told(graph)["level"] == "2"
        assert int(told(graph)["images_dropped"]) > before
        service.signal(signal.SIGCONT)
        service.kill()

    count = len(poses)
    filming(graph, here, lambda: "revisit serve" in told(graph).get("remedy", ""))
    assert trigger(graph).success is False
    assert len(poses) == count

    with RunningService(tmp_path, REVISIT_PORT=port):
        filming(graph, here, lambda: len(poses) > count and told(graph)["state"] == "working")
        keys(tmp_path, "create", "other", "--scope", "read")  # from the first one on, the service asks for a key
        filming(graph, here, lambda: told(graph)["state"] == "key refused")
        assert told(graph)["level"] == "2"
        assert "keys create" in told(graph)["remedy"]
    localize.close()
