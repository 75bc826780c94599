"""Elements of a scene, and the pinhole camera.

World coordinates are metres: x to the right, y ahead, z up; the ground is z = 0.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.uint8]
Vector = npt.NDArray[np.float64]

EYE_HEIGHT = 1.65
FIELD_OF_VIEW = math.radians(68)


def vector(x: float, y: float, z: float) -> Vector:
    """A point or a direction, float64 (3,)."""
    return np.array([x, y, z], np.float64)


@dataclass(frozen=True, eq=False)
class Surface:
    """A textured parallelogram.

    Parameters
    ----------
    origin : float64 of shape (3,)
        The texture's upper left corner.
    across, down : float64 of shape (3,)
        From that corner along the texture's first row and first column, in full length.
        ``down x across`` points to the visible, lit side.
    texture : uint8 of shape (height, width, 3 or 4)
        RGB of the material in white light; a fourth channel below 128 cuts holes.
    label : int or uint8 of shape (height, width)
        One label for the surface, or one per texel.
    glow : uint8 of shape (height, width, 3) or None
        RGB emitted when lamps are lit.
    """

    origin: Vector
    across: Vector
    down: Vector
    texture: Pixels
    label: int | Pixels
    glow: Pixels | None = None

    @functools.cached_property
    def normal(self) -> Vector:
        """Unit vector of the visible side."""
        n = np.cross(self.down, self.across)
        return np.asarray(n / max(float(np.linalg.norm(n)), 1e-9))


@dataclass(frozen=True, eq=False)
class Sprite:
    """An upright cut-out that always faces the camera: a clump of leaves, a person.

    Parameters
    ----------
    centre : float64 of shape (3,)
    width, height : float
        Metres.
    texture : uint8 of shape (rows, columns, 4)
        RGBA.
    brightness : float
        Factor on the light that reaches it: the inside of a crown is darker than its top.
    """

    centre: Vector
    width: float
    height: float
    texture: Pixels
    label: int
    brightness: float = 1.0


@dataclass(frozen=True)
class Lamp:
    """A point light: position in metres, colour as RGB factors, and the metres at which half its power is left."""

    position: tuple[float, float, float]
    colour: tuple[float, float, float] = (1.0, 0.82, 0.55)
    reach: float = 3.0


@dataclass
class Place:
    """The fixed part of a scene.

    Parameters
    ----------
    shadows : list of float64 arrays of shape (n, 3)
        Footprint (x, y) and height, in metres, of each object that casts a shadow on the ground.
    ground : tuple of (x0, x1, y0, y1)
        Extent of the ground texture in metres.
    start : Viewpoint
        The place's own viewpoint, to which others are relative.
    stands : mapping of thing to (x, y, heading in degrees)
        Where a passing thing stands, in metres and degrees.
    """

    start: "Viewpoint"
    surfaces: list[Surface] = field(default_factory=list)
    sprites: list[Sprite] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    shadows: list[Vector] = field(default_factory=list)
    ground: tuple[float, float, float, float] | None = None
    ground_texture: Pixels | None = None
    ground_labels: Pixels | None = None
    stands: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    indoors: bool = False


@dataclass(frozen=True)
class Viewpoint:
    """Camera pose relative to the place's own: metres to the right, ahead, up; degrees to the right, up."""

    dx: float = 0.0
    ahead: float = 0.0
    up: float = 0.0
    turn: float = 0.0
    tilt: float = 0.0

    def then(self, other: "Viewpoint") -> "Viewpoint":
        """Compose: `other` is relative to this viewpoint's directions."""
        c, s = math.cos(math.radians(self.turn)), math.sin(math.radians(self.turn))
        return Viewpoint(
            self.dx + c * other.dx + s * other.ahead,
            self.ahead - s * other.dx + c * other.ahead,
            self.up + other.up,
            self.turn + other.turn,
            self.tilt + other.tilt,
        )


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera.

    Parameters
    ----------
    position : float64 of shape (3,)
    rotation : float64 of shape (3, 3)
        Rows are the camera's right, down and forward in the world.
    focal : float
        Pixels.
    size : (int, int)
        (width, height) in pixels.
    """

    position: Vector
    rotation: Vector
    focal: float
    size: tuple[int, int]

    @classmethod
    def at(cls, viewpoint: Viewpoint, size: tuple[int, int]) -> "Camera":
        """A camera at eye height; the longer side of the image spans `FIELD_OF_VIEW`."""
        turn, tilt = math.radians(viewpoint.turn), math.radians(viewpoint.tilt)
        forward = vector(math.sin(turn) * math.cos(tilt), math.cos(turn) * math.cos(tilt), math.sin(tilt))
        right = vector(math.cos(turn), -math.sin(turn), 0.0)
        down = np.cross(forward, right)
        position = vector(viewpoint.dx, viewpoint.ahead, EYE_HEIGHT + viewpoint.up)
        focal = max(size) / 2 / math.tan(FIELD_OF_VIEW / 2)
        return cls(position, np.stack([right, down, forward]), focal, size)

    @property
    def intrinsics(self) -> Vector:
        """3 x 3 matrix from camera coordinates to pixels (centre of the first pixel is 0, 0)."""
        width, height = self.size
        return np.array([[self.focal, 0, width / 2 - 0.5], [0, self.focal, height / 2 - 0.5], [0, 0, 1.0]])

    def seen(self, points: Sequence[Vector] | Vector) -> Vector:
        """World points (..., 3) in camera coordinates (right, down, depth), in metres."""
        return np.asarray((np.asarray(points) - self.position) @ self.rotation.T)


def box(
    x: tuple[float, float],
    y: tuple[float, float],
    z: tuple[float, float],
    texture: Pixels,
    label: int,
    *,
    top: Pixels | None = None,
) -> list[Surface]:
    """An upright box: `texture` on its four sides, `top` (default: `texture`) on lid and bottom."""
    (x0, x1), (y0, y1), (z0, z1) = x, y, z
    down = vector(0, 0, z0 - z1)
    sides = [
        Surface(vector(x0, y0, z1), vector(x1 - x0, 0, 0), down, texture, label),
        Surface(vector(x1, y0, z1), vector(0, y1 - y0, 0), down, texture, label),
        Surface(vector(x1, y1, z1), vector(x0 - x1, 0, 0), down, texture, label),
        Surface(vector(x0, y1, z1), vector(0, y0 - y1, 0), down, texture, label),
    ]
    lid = texture if top is None else top
    sides.append(Surface(vector(x0, y1, z1), vector(x1 - x0, 0, 0), vector(0, y0 - y1, 0), lid, label))
    sides.append(Surface(vector(x0, y0, z0), vector(x1 - x0, 0, 0), vector(0, y1 - y0, 0), lid, label))
    return sides


def standing(surfaces: Sequence[Surface], x: float, y: float, heading: float) -> list[Surface]:
    """Surfaces turned clockwise by `heading` degrees about the origin, then moved to (x, y)."""
    c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    rotate = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    offset = vector(x, y, 0)
    return [
        Surface(rotate @ f.origin + offset, rotate @ f.across, rotate @ f.down, f.texture, f.label, f.glow)
        for f in surfaces
    ]
