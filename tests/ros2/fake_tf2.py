"""tf2_ros, as far as the nodes use it: a buffer that is fed by /tf and /tf_static, refuses what it would have to guess,
and composes transforms as matrices, so that it shares nothing with the code under test."""

import types
from typing import Any

import numpy as np
import numpy.typing as npt

from tests.ros2.interfaces import message

Matrix = npt.NDArray[np.float64]


class TransformException(Exception):
    pass


class Buffer:
    """One moving transform interpolates between its stamps; a static one holds at all."""

    def __init__(self) -> None:
        self.moving: dict[str, dict[int, tuple[str, Matrix]]] = {}
        self.static: dict[str, tuple[str, Matrix]] = {}

    def lookup_transform(self, target: str, source: str, stamp: Any) -> Any:
        if not source or not target:
            raise TransformException("frame_id cannot be empty")
        here, there = self._chain(source, stamp.nanoseconds), self._chain(target, stamp.nanoseconds)
        if here[0] != there[0]:
            raise TransformException(f"{source} and {target} are not in one tree")
        return as_message(np.linalg.inv(there[1]) @ here[1], target, source)

    def _chain(self, frame: str, stamp: int) -> tuple[str, Matrix]:
        """The root of a frame's tree, and the frame in it."""
        placed = np.eye(4)
        while frame in self.static or frame in self.moving:
            frame, step = self.static[frame] if frame in self.static else self._at(frame, stamp)
            placed = step @ placed
        return frame, placed

    def _at(self, frame: str, stamp: int) -> tuple[str, Matrix]:
        stamps = sorted(self.moving[frame])
        if not stamps[0] <= stamp <= stamps[-1]:
            raise TransformException("lookup would require extrapolation")
        later = next(one for one in stamps if one >= stamp)
        earlier = next(one for one in reversed(stamps) if one <= stamp)
        parent, end = self.moving[frame][later]
        _, begin = self.moving[frame][earlier]
        between = begin.copy()
        if later > earlier:
            between[:3, 3] += (stamp - earlier) / (later - earlier) * (end[:3, 3] - begin[:3, 3])
        return parent, between


class TransformListener:
    def __init__(self, buffer: Buffer, node: Any) -> None:
        from tests.ros2.interfaces import made

        def moving(given: Any) -> None:
            for one in given.transforms:
                stamp = one.header.stamp.sec * 10**9 + one.header.stamp.nanosec
                buffer.moving.setdefault(one.child_frame_id, {})[stamp] = (one.header.frame_id, as_matrix(one))

        def static(given: Any) -> None:
            for one in given.transforms:
                buffer.static[one.child_frame_id] = (one.header.frame_id, as_matrix(one))

        node.create_subscription(made["tf2_msgs/TFMessage"], "/tf", moving, 100)
        node.create_subscription(made["tf2_msgs/TFMessage"], "/tf_static", static, 100)


def as_matrix(given: Any) -> Matrix:
    """4 x 4."""
    t, q = given.transform.translation, given.transform.rotation
    x, y, z, w = q.x, q.y, q.z, q.w
    placed = np.eye(4)
    placed[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    placed[:3, 3] = t.x, t.y, t.z
    return placed


def as_message(placed: Matrix, parent: str, child: str, stamp: int = 0) -> Any:
    """geometry_msgs/TransformStamped, with the quaternion from the largest of its four parts (Shepperd, 1978)."""
    r = placed[:3, :3]
    squares = np.array([1 + r[0, 0] - r[1, 1] - r[2, 2], 1 - r[0, 0] + r[1, 1] - r[2, 2]])
    squares = np.append(squares, [1 - r[0, 0] - r[1, 1] + r[2, 2], 1 + r[0, 0] + r[1, 1] + r[2, 2]])
    symmetric, turned = r + r.T, r - r.T
    rows = np.array(
        [
            [squares[0], symmetric[0, 1], symmetric[0, 2], -turned[1, 2]],
            [symmetric[0, 1], squares[1], symmetric[1, 2], turned[0, 2]],
            [symmetric[0, 2], symmetric[1, 2], squares[2], -turned[0, 1]],
            [-turned[1, 2], turned[0, 2], -turned[0, 1], squares[3]],
        ]
    )
    q = rows[int(np.argmax(squares))]
    q = q / np.linalg.norm(q)
    made = message("geometry_msgs/TransformStamped")
    made.header.frame_id, made.child_frame_id = parent, child
    made.header.stamp = message("builtin_interfaces/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
    for axis, value in zip("xyz", placed[:3, 3], strict=True):
        setattr(made.transform.translation, axis, float(value))
    for axis, value in zip("xyzw", q, strict=True):
        setattr(made.transform.rotation, axis, float(value))
    return made


def modules() -> dict[str, types.ModuleType]:
    """tf2_ros, as ``sys.modules`` has it."""
    found = types.ModuleType("tf2_ros")
    vars(found).update(Buffer=Buffer, TransformListener=TransformListener, TransformException=TransformException)
    return {"tf2_ros": found}
