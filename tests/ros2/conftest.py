"""The nodes of deploy/ros2 on stand-ins for ROS 2, which cannot be installed here."""

import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from tests.ros2 import fake_rclpy, fake_tf2, interfaces
from tests.ros2.fake_rclpy import Graph
from tests.ros2.serving import Service

OURS = ("revisit_ros.messages", "revisit_ros.node", "revisit_ros.localize_node", "revisit_ros.enroll_node")
"""What imports ROS, and is imported anew for each test."""


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> Iterator[fake_rclpy.Graph]:
    """A graph without nodes."""
    for name, module in (fake_rclpy.modules() | fake_tf2.modules() | interfaces.modules()).items():
        monkeypatch.setitem(sys.modules, name, module)
    for name in OURS:
        monkeypatch.delitem(sys.modules, name, raising=False)
    for name in ("REVISIT_URL", "REVISIT_KEY"):
        monkeypatch.delenv(name, raising=False)
    yield fake_rclpy.fresh()
    for name in OURS:
        sys.modules.pop(name, None)


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Service:
    import revisit_client

    service = Service()

    class Here(revisit_client.Revisit):
        def __init__(self, url: str | None, **options: Any) -> None:
            super().__init__(url, transport=httpx.MockTransport(service), **options)

    monkeypatch.setattr("revisit_client.Revisit", Here)
    return service


@pytest.fixture
def start(graph: Graph) -> Iterator[Callable[..., Any]]:
    """Start a node with parameters."""
    running: list[Any] = []

    def started(name: str, **parameters: Any) -> Any:
        graph.parameters[name] = {"silence": 600} | parameters  # a busy machine is slow, not silent
        module = importlib.import_module(f"revisit_ros.{name}_node")
        running.append((module.LocalizeNode if name == "localize" else module.EnrollNode)())
        return running[-1]

    yield started
    for node in running:
        node.close()
