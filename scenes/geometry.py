"""What a scene is made of, and the pinhole camera that looks at it.

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
        ``down x across`` points to the side that is seen, and lit.
    texture : uint8 of shape (height, width, 3 or 4)
        RGB of the material in white light; a fourth channel below 128 cuts holes.
    label : int or uint8 of shape (height, width)
        One for all, or one per texel.
    glow : uint8 of shape (height, width, 3) or None
        Light the surface gives itself when lamps are lit.
    """

    origin: Vector
    across: Vector
    down: Vector
    texture: Pixels
    label: int | Pixels
    glow: Pixels | None = None

    @functools.cached_property
    def normal(self) -> Vector:
        """Unit vector towards the side that is seen."""
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
        How much of the light reaches it: the inside of a crown is darker than its top.
    """

    centre: Vector
    width: float
    height: float
    texture: Pixels
    label: int
    brightness: float = 1.0


@dataclass(frozen=True)
class Lamp:
    """A point light: position, colour as RGB 0..1, and the distance in metres at which it has lost half its power."""

    position: tuple[float, float, float]
    colour: tuple[float, float, float] = (1.0, 0.82, 0.55)
    reach: float = 3.0


@dataclass
class Place:
    """Everything that stays where it is.

    Parameters
    ----------
    shadows : list of float64 arrays of shape (n, 3)
        Footprints (x, y) and height of what throws shadows on the ground.
    ground : tuple of (x0, x1, y0, y1)
        Extent of the ground's map in metres.
    start : Viewpoint
        Where the picture "of the place" is taken.
    stands : mapping of thing to (x, y, heading in degrees)
        Where a thing stops when it comes into the picture.
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
    """Where the camera is, relative to the place's own: metres to the right, ahead, up; degrees to the right, up."""

    dx: float = 0.0
    ahead: float = 0.0
    up: float = 0.0
    turn: float = 0.0
    tilt: float = 0.0

    def then(self, other: "Viewpoint") -> "Viewpoint":
        """This viewpoint, and from there the other (offsets along this one's directions)."""
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
        """A camera at eye height; the wider side spans the field of view."""
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
        """World points in camera coordinates (right, down, depth)."""
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
    """An upright box with the same texture on its four sides, and a lid."""
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
    """Surfaces made around the origin, moved to a spot and turned clockwise by `heading` degrees."""
    c, s = math.cos(math.radians(heading)), math.sin(math.radians(heading))
    rotate = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    offset = vector(x, y, 0)
    return [
        Surface(rotate @ f.origin + offset, rotate @ f.across, rotate @ f.down, f.texture, f.label, f.glow)
        for f in surfaces
    ]
