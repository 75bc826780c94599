"""The nodes of deploy/ros2 on stand-ins for ROS 2, which cannot be installed here."""

import sys
from collections.abc import Iterator

import pytest

from tests.ros2 import fake_rclpy, fake_tf2, interfaces

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
