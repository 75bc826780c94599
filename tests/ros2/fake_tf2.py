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
        ours, theirs = self._above(source), self._above(target)
        common = next((frame for frame in ours if frame in theirs), None)
        if common is None:
            raise TransformException(f"{source} and {target} are not in one tree")
        ways = ours[: ours.index(common)], theirs[: theirs.index(common)]
        latest = [max(self.moving[frame]) for way in ways for frame in way if frame not in self.static]
        at = stamp.nanoseconds or min(latest, default=0)  # 0: the latest at which all are known
        here, there = (self._placed(way, at) for way in ways)
        return as_message(np.linalg.inv(there) @ here, target, source, at)

    def _above(self, frame: str) -> list[str]:
        """A frame, its parent, and so on up to the root."""
        found = [frame]
        while frame in self.static or frame in self.moving:
            frame = self.static[frame][0] if frame in self.static else next(iter(self.moving[frame].values()))[0]
            found.append(frame)
        return found

    def _placed(self, way: list[str], stamp: int) -> Matrix:
        """The first frame of a way up, in the parent of the last."""
        placed = np.eye(4)
        for frame in way:
            _, step = self.static[frame] if frame in self.static else self._at(frame, stamp)
            placed = step @ placed
        return placed

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


class TransformBroadcaster:
    def __init__(self, node: Any) -> None:
        self._publisher = node.create_publisher(message("tf2_msgs/TFMessage").__class__, "/tf", 100)

    def sendTransform(self, transform: Any) -> None:  # noqa: N802  # its name
        self._publisher.publish(message("tf2_msgs/TFMessage", transforms=[transform]))


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
    kinds = (Buffer, TransformBroadcaster, TransformException, TransformListener)
    vars(found).update({kind.__name__: kind for kind in kinds})
    return {"tf2_ros": found}
