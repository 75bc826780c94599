"""Axes and angles: between headings (degrees clockwise from +y) and ROS (REP 103: x east, y north, yaw from x)."""

import math
from dataclasses import dataclass

Vector = tuple[float, float, float]

STEEP = math.cos(math.radians(75))
"""Horizontal part of a direction below which it points up or down, and has no heading."""


@dataclass(frozen=True)
class Transform:
    """Where a frame lies in another: a point p of the frame lies at rotation * p + translation.

    Parameters
    ----------
    x, y, z : float
        Translation, metres.
    qx, qy, qz, qw : float
        Rotation as a quaternion of any length but 0; it is made unit length.

    Raises
    ------
    ValueError
        A number that is not finite, or a quaternion of length 0.
    """

    x: float
    y: float
    z: float
    qx: float = 0.0
    qy: float = 0.0
    qz: float = 0.0
    qw: float = 1.0

    def __post_init__(self) -> None:
        numbers = (self.x, self.y, self.z, self.qx, self.qy, self.qz, self.qw)
        length = math.sqrt(sum(part * part for part in numbers[3:]))
        if not all(map(math.isfinite, numbers)) or length < 1e-6 or not math.isfinite(length):
            raise ValueError(f"{numbers} is no transform: numbers have to be finite and the quaternion not 0")
        for name in ("qx", "qy", "qz", "qw"):
            object.__setattr__(self, name, getattr(self, name) / length)

    def after(self, inner: "Transform") -> "Transform":
        """Where a frame lies in the outermost of three: `inner` places it in the frame that this one places."""
        x, y, z = self.rotated((inner.x, inner.y, inner.z))
        a, b = (self.qx, self.qy, self.qz), (inner.qx, inner.qy, inner.qz)
        across = _cross(a, b)
        qx, qy, qz = (self.qw * b[axis] + inner.qw * a[axis] + across[axis] for axis in range(3))
        qw = self.qw * inner.qw - sum(one * other for one, other in zip(a, b, strict=True))
        return Transform(self.x + x, self.y + y, self.z + z, qx, qy, qz, qw)

    def inverse(self) -> "Transform":
        """Where the other frame lies in this one."""
        back = Transform(0.0, 0.0, 0.0, -self.qx, -self.qy, -self.qz, self.qw)
        x, y, z = back.rotated((-self.x, -self.y, -self.z))
        return Transform(x, y, z, back.qx, back.qy, back.qz, back.qw)

    def rotated(self, vector: Vector) -> Vector:
        """A direction of the frame, in the other frame."""
        u = (self.qx, self.qy, self.qz)
        # v + 2 w (u x v) + 2 u x (u x v)
        across = _cross(u, vector)
        twice = _cross(u, across)
        return (
            vector[0] + 2 * (self.qw * across[0] + twice[0]),
            vector[1] + 2 * (self.qw * across[1] + twice[1]),
            vector[2] + 2 * (self.qw * across[2] + twice[2]),
        )


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


FORWARD: dict[str, Vector] = {"z": (0.0, 0.0, 1.0), "x": (1.0, 0.0, 0.0)}
"""Where a camera looks in its own frame: along z in an optical frame (REP 103), along x in a body frame."""


def yaw_of_heading(heading: float) -> float:
    """Radians counter-clockwise from +x, in (-pi, pi], of degrees clockwise from +y."""
    return _wrapped(math.radians(90 - heading))


def heading_of_yaw(yaw: float) -> float:
    """Degrees clockwise from +y, in [0, 360), of radians counter-clockwise from +x."""
    heading = (90 - math.degrees(yaw)) % 360
    return 0.0 if heading == 360 else heading  # a tiny negative angle rounds up to 360


def yaw_of(placed: Transform, forward: Vector) -> float | None:
    """Yaw of a direction of a frame, such as where a camera looks, where it is placed; None where it is up or down."""
    x, y, _ = placed.rotated(forward)
    return math.atan2(y, x) if math.hypot(x, y) > STEEP else None


def quaternion_of_yaw(yaw: float) -> tuple[float, float, float, float]:
    """(x, y, z, w) of a rotation about z."""
    return 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)


def level(position: Vector, yaw: float) -> Transform:
    """Where a frame lies that stands level."""
    return Transform(*position, *quaternion_of_yaw(yaw))


def base_of_camera(position: Vector, yaw: float, mount: Transform, mount_yaw: float) -> tuple[Vector, float]:
    """Position and yaw of a robot that stands level, from those of its camera.

    Parameters
    ----------
    position, yaw
        Of the camera in the map, metres and radians.
    mount : Transform
        The camera in the robot's base.
    mount_yaw : float
        Where it looks there (`yaw_of`).
    """
    base = _wrapped(yaw - mount_yaw)
    x = math.cos(base) * mount.x - math.sin(base) * mount.y
    y = math.sin(base) * mount.x + math.cos(base) * mount.y
    return (position[0] - x, position[1] - y, position[2] - mount.z), base


def _wrapped(angle: float) -> float:
    """The angle in (-pi, pi]."""
    turned = math.remainder(angle, math.tau)
    return math.pi if turned == -math.pi else turned
