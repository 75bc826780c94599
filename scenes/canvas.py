"""The image being drawn: colour, label and depth of every pixel, so that drawing order does not matter."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from scenes.geometry import Camera, Pixels, Sprite, Surface, Vector

NEAR = 0.2

SurfaceLight = Callable[[Surface, Pixels, Pixels | None], Pixels]
SpriteLight = Callable[[Sprite, Pixels], Pixels]


class Canvas:
    """Colours (uint8 RGB), labels and `closeness` (inverse depth, 1/m, 0 is the sky) of one image."""

    def __init__(self, camera: Camera, background: Pixels, label: int) -> None:
        self.camera = camera
        width, height = camera.size
        self.colours: Pixels = background
        self.labels: Pixels = np.full((height, width), label, np.uint8)
        self.closeness: npt.NDArray[np.float32] = np.zeros((height, width), np.float32)

    def draw(self, surface: Surface, light: SurfaceLight) -> None:
        """Draw a surface; `light` gets its texture (and glow) at the size that the image needs."""
        camera = self.camera
        if surface.texture.shape[2] == 3 and surface.normal @ (camera.position - surface.origin) <= 0:
            return  # the back of an opaque surface
        corners = _corners(surface)
        seen = camera.seen(corners)
        outline = _clip(seen)
        if len(outline) < 3:
            return
        on_image = outline[:, :2] / outline[:, 2:] * camera.focal + camera.intrinsics[:2, 2]
        window = self._window(on_image.min(axis=0), on_image.max(axis=0))
        if window is None:
            return
        left, top, right, bottom = window
        # From (s, t, 1), s and t in 0..1 over the surface, to pixels times depth; the inverse's last row is 1/depth.
        to_image = (
            camera.intrinsics
            @ camera.rotation
            @ np.stack([surface.across, surface.down, surface.origin - camera.position], axis=1)
        )
        if abs(np.linalg.det(to_image)) < 1e-6:
            return  # seen exactly edge-on
        to_surface = np.linalg.inv(to_image)
        to_surface = to_surface @ np.array([[1, 0, left], [0, 1, top], [0, 0, 1.0]])
        area = (right - left, bottom - top)
        mask = np.zeros((area[1], area[0]), np.uint8)
        fixed = np.round((on_image - (left, top)) * 256).astype(np.int32)
        cv2.fillConvexPoly(mask, fixed, 255, lineType=cv2.LINE_8, shift=8)
        a, b, c = to_surface[2]
        columns = (a * np.arange(area[0]) + c).astype(np.float32)
        rows = (b * np.arange(area[1])).astype(np.float32)
        closeness = rows[:, None] + columns[None, :]
        front = self._in_front(window, mask, closeness)
        if front is None:
            return
        size = self._needed(surface.texture.shape, to_image, to_surface, on_image, window)
        glow = None if surface.glow is None else _shrunk(surface.glow, size)
        texture = light(surface, _shrunk(surface.texture, size), glow)
        height, width = texture.shape[:2]
        texel = np.array([[width, 0, -0.5], [0, height, -0.5], [0, 0, 1.0]]) @ to_surface
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        colours = cv2.warpPerspective(texture, texel, area, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        if colours.shape[2] == 4:
            front[colours[..., 3] < 128] = 0
            colours = np.ascontiguousarray(colours[..., :3])
        labels = surface.label
        if not isinstance(labels, int):
            if size is not None:
                labels = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST)
            flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
            labels = cv2.warpPerspective(labels, texel, area, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        self._put(window, front, closeness, colours, labels)

    def draw_sprite(self, sprite: Sprite, light: SpriteLight) -> None:
        """Draw a cut-out that faces the camera; `light` as in `draw`."""
        x, y, depth = self.camera.seen(sprite.centre)
        if depth < 0.6:
            return
        scale = self.camera.focal / depth
        half = np.array([sprite.width, sprite.height]) * scale / 2
        centre = np.array([x, y]) * scale + self.camera.intrinsics[:2, 2]
        low, high = np.round(centre - half).astype(int), np.round(centre + half).astype(int)
        window = self._window(low, high - 1)
        if window is None or (high - low).min() < 1:
            return
        left, top, right, bottom = window
        seen = np.full((bottom - top, right - left), 255, np.uint8)
        closeness = np.full(seen.shape, 1 / depth, np.float32)
        front = self._in_front(window, seen, closeness)
        if front is None:
            return
        width, height = (int(n) for n in high - low)
        shrinks = width < sprite.texture.shape[1]
        how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        texture = cv2.resize(sprite.texture, (width, height), interpolation=how)
        texture = light(sprite, texture[top - low[1] : bottom - low[1], left - low[0] : right - low[0]])
        # Leaves smaller than pixels average to partial alpha: a threshold below 128 keeps far crowns from thinning.
        front[texture[..., 3] < 100] = 0
        self._put(window, front, closeness, np.ascontiguousarray(texture[..., :3]), sprite.label)

    def _window(self, low: Vector, high: Vector) -> tuple[int, int, int, int] | None:
        width, height = self.camera.size
        left, top = max(0, math.floor(low[0])), max(0, math.floor(low[1]))
        right, bottom = min(width, math.ceil(high[0]) + 1), min(height, math.ceil(high[1]) + 1)
        return (left, top, right, bottom) if left < right and top < bottom else None

    def _in_front(
        self, window: tuple[int, int, int, int], mask: Pixels, closeness: npt.NDArray[np.float32]
    ) -> Pixels | None:
        """255 for the pixels of a window that are nearer than what is drawn there; None where there is none."""
        left, top, right, bottom = window
        nearer = cv2.compare(closeness, self.closeness[top:bottom, left:right], cv2.CMP_GT)
        front = cv2.bitwise_and(mask, nearer)
        return front if cv2.hasNonZero(front) else None

    def _put(
        self,
        window: tuple[int, int, int, int],
        front: Pixels,
        closeness: npt.NDArray[np.float32],
        colours: Pixels,
        label: int | Pixels,
    ) -> None:
        left, top, right, bottom = window
        area = (slice(top, bottom), slice(left, right))
        cv2.copyTo(closeness, front, self.closeness[area])
        cv2.copyTo(colours, front, self.colours[area])
        if isinstance(label, int):
            self.labels[area][front > 0] = label
        else:
            cv2.copyTo(label, front, self.labels[area])

    @staticmethod
    def _needed(
        shape: tuple[int, ...],
        to_image: Vector,
        to_surface: Vector,
        on_image: Vector,
        window: tuple[int, int, int, int],
    ) -> tuple[int, int] | None:
        """(width, height) of the texture at the resolution of the image, so that far bricks do not alias.

        None when the texture needs no shrinking.
        """
        left, top, right, bottom = window
        middle = np.clip(on_image.mean(axis=0), (left, top), (right, bottom)) - (left, top)
        point = to_surface @ np.array([middle[0], middle[1], 1.0])
        s, t = point[:2] / point[2]
        p = to_image @ np.array([s, t, 1.0])
        # Derivatives of the pixel by s and by t: how many pixels the surface would span there.
        spans = [np.hypot(*(to_image[:2, k] - p[:2] / p[2] * to_image[2, k])) / abs(p[2]) for k in (0, 1)]
        height, width = shape[:2]
        new_width = int(np.clip(math.ceil(spans[0]), 2, width))
        new_height = int(np.clip(math.ceil(spans[1]), 2, height))
        if new_width > 0.8 * width and new_height > 0.8 * height:
            return None
        return new_width, new_height


def _shrunk(image: Pixels, size: tuple[int, int] | None) -> Pixels:
    if size is None:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _corners(surface: Surface) -> Vector:
    o, a, d = surface.origin, surface.across, surface.down
    return np.stack([o, o + a, o + a + d, o + d])


def _clip(polygon: Vector) -> Vector:
    """The part of a polygon (camera coordinates) in front of the near plane (Sutherland-Hodgman)."""
    kept = []
    for i, point in enumerate(polygon):
        before = polygon[i - 1]
        if (point[2] >= NEAR) != (before[2] >= NEAR):
            share = (NEAR - before[2]) / (point[2] - before[2])
            kept.append(before + share * (point - before))
        if point[2] >= NEAR:
            kept.append(point)
    return np.asarray(kept)
