"""Light of sun, sky and lamps on materials; the sky; bloom, vignetting and grain of the camera."""

import functools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from scenes import materials
from scenes.geometry import Camera, Lamp, Pixels, Place, Sprite, Surface

Colour3 = tuple[float, float, float]


@dataclass(frozen=True)
class Daylight:
    """One lighting. Colours are factors (1 leaves a material as it is) or, for the sky, RGB 0..255."""

    ambient: Colour3
    sun: Colour3
    sun_from: Colour3
    zenith: Colour3
    horizon: Colour3
    clouds: Colour3
    cloudiness: float
    haze: float
    lamps: float
    grain: float
    shadow: float


CONDITIONS = {
    "noon": Daylight(
        ambient=(0.62, 0.66, 0.74), sun=(0.56, 0.53, 0.46), sun_from=(-0.55, -0.45, 0.85), zenith=(74, 128, 196),
        horizon=(186, 208, 226), clouds=(246, 246, 248), cloudiness=0.35, haze=0.0035, lamps=0.0, grain=2.0, shadow=0.5,
    ),
    "overcast": Daylight(
        ambient=(0.80, 0.82, 0.85), sun=(0.04, 0.04, 0.04), sun_from=(0, 0, 1.0), zenith=(176, 182, 190),
        horizon=(212, 215, 218), clouds=(228, 230, 232), cloudiness=1.0, haze=0.006, lamps=0.0, grain=2.5, shadow=0.12,
    ),
    "dusk": Daylight(
        ambient=(0.42, 0.38, 0.46), sun=(0.42, 0.22, 0.08), sun_from=(0.8, -0.35, 0.28), zenith=(62, 74, 122),
        horizon=(240, 170, 112), clouds=(214, 132, 118), cloudiness=0.55, haze=0.006, lamps=0.45, grain=4.0, shadow=0.3,
    ),
    "night": Daylight(
        ambient=(0.115, 0.12, 0.165), sun=(0.0, 0.0, 0.0), sun_from=(0, 0, 1.0), zenith=(10, 13, 28),
        horizon=(44, 40, 50), clouds=(34, 32, 42), cloudiness=0.4, haze=0.004, lamps=1.0, grain=7.0, shadow=0.0,
    ),
}  # fmt: skip
"""Lighting outdoors, by name."""

INDOORS = {
    "noon": (1.0, (0.62, 0.63, 0.64)),
    "overcast": (0.85, (0.54, 0.56, 0.60)),
    "dusk": (0.8, (0.46, 0.41, 0.36)),
    "night": (0.3, (0.24, 0.22, 0.21)),
}
"""Lighting indoors, by the same names: (power of the lamps, ambient light)."""


class Light:
    """Lights the surfaces and sprites of one place under the lighting `name`."""

    def __init__(self, name: str, place: Place) -> None:
        self.day = CONDITIONS[name]
        self.lamps: list[Lamp] = place.lamps
        self.power, self.ambient = self.day.lamps, self.day.ambient
        self.sun: Colour3 = self.day.sun
        if place.indoors:
            self.power, self.ambient = INDOORS[name]
            self.sun = (0.0, 0.0, 0.0)
        direction = np.array(self.day.sun_from, np.float64)
        self.to_sun = direction / np.linalg.norm(direction)

    def on(self, surface: Surface, texture: Pixels, glow: Pixels | None) -> Pixels:
        """The surface's texture, of any size, in this light; alpha is kept."""
        facing = max(0.0, float(surface.normal @ self.to_sun))
        # Surfaces that face the sky get more of the ambient light.
        openness = 0.82 + 0.18 * (0.5 + 0.5 * float(surface.normal[2]))
        factor = np.array(self.ambient) * openness + np.array(self.sun) * facing
        colours = texture[..., :3].astype(np.float32) * factor.astype(np.float32)
        if self.power > 0:
            lit = self._from_lamps(surface, (texture.shape[1], texture.shape[0]))
            if lit is not None:
                colours += texture[..., :3] * lit
            if glow is not None:
                colours += glow * np.float32(min(1.0, self.power * 0.95))
        shaded = np.clip(colours, 0, 255).astype(np.uint8)
        return shaded if texture.shape[2] == 3 else np.dstack([shaded, texture[..., 3]])

    def on_sprite(self, sprite: Sprite, texture: Pixels) -> Pixels:
        """The sprite's texture in this light."""
        factor = np.array(self.ambient) + 0.75 * np.array(self.sun)
        if self.power > 0:
            factor = factor + self.power * self._at(sprite.centre[None, :], None)[0] * 0.8
        table = np.clip(np.arange(256)[:, None] * (factor * sprite.brightness)[None, :], 0, 255).astype(np.uint8)
        both = np.concatenate([table, np.arange(256)[:, None].astype(np.uint8)], axis=1)
        return np.asarray(cv2.LUT(texture, both[None]), np.uint8)

    def _at(self, points: npt.NDArray[np.float64], normal: npt.NDArray[np.float64] | None) -> npt.NDArray[np.float64]:
        """Light of the lamps at points (n, 3), as RGB factors, float64 (n, 3)."""
        total = np.zeros((len(points), 3))
        for lamp in self.lamps:
            to_lamp = np.array(lamp.position) - points
            square = (to_lamp**2).sum(axis=1)
            facing = np.ones(len(points))
            if normal is not None:
                facing = np.clip(to_lamp @ normal / np.sqrt(square + 1e-6), 0, 1) * 0.85 + 0.15
            total += np.array(lamp.colour) * (facing / (1 + square / lamp.reach**2))[:, None]
        return total

    def _from_lamps(self, surface: Surface, size: tuple[int, int]) -> npt.NDArray[np.float32] | None:
        if not self.lamps:
            return None
        columns = int(np.clip(np.linalg.norm(surface.across) * 2, 2, 48))
        rows = int(np.clip(np.linalg.norm(surface.down) * 2, 2, 96))
        s, t = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        points = surface.origin + t[:, None, None] * surface.down + s[None, :, None] * surface.across
        light = self._at(points.reshape(-1, 3), surface.normal).reshape(rows, columns, 3)
        grown = cv2.resize((light * self.power).astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(grown, np.float32)

    def shadow_map(self, place: Place, size: tuple[int, int]) -> npt.NDArray[np.float32] | None:
        """Factor on the ground texture (height, width): cast shadows, and contact shadows at the feet of walls."""
        if place.ground is None:
            return None
        x0, x1, y0, y1 = place.ground
        height, width = size
        scale = np.array([(width / (x1 - x0)), -(height / (y1 - y0))])
        mask = np.zeros(size, np.uint8)
        contact = np.zeros(size, np.uint8)
        slope = self.to_sun[:2] / max(self.to_sun[2], 0.25)
        for shape in place.shadows:
            thrown = shape[:, :2] - shape[:, 2:] * slope
            both = np.concatenate([shape[:, :2], thrown]) if shape[:, 2].max() < 40 else shape[:, :2]
            for target, points in ((mask, both), (contact, shape[:, :2])):
                at = (points - (x0, y1)) * scale
                hull = cv2.convexHull(np.int32(np.clip(at, -20000, 20000)))
                cv2.fillConvexPoly(target, hull, 255)
        blurred = cv2.GaussianBlur(mask, (0, 0), 2.2).astype(np.float32) / 255
        near = cv2.GaussianBlur(contact, (0, 0), 9).astype(np.float32) / 255
        return np.asarray((1 - self.day.shadow * blurred) * (1 - 0.38 * near), np.float32)


def sky(camera: Camera, day: Daylight, rng: np.random.Generator) -> Pixels:
    """Gradient, clouds and, at night, stars in this camera's view; RGB (height, width, 3)."""
    width, height = camera.size
    small = (max(2, width // 4), max(2, height // 4))
    x, y = np.meshgrid(np.arange(small[0]) * 4 - width / 2 + 2, np.arange(small[1]) * 4 - height / 2 + 2)
    rays = np.stack([x, y, np.full_like(x, camera.focal)], axis=-1) @ camera.rotation
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rise = np.clip(rays[..., 2], 0, 1)
    share = (np.clip(rise / 0.75, 0, 1) ** 0.6)[..., None]
    colours = (1 - share) * np.array(day.horizon) + share * np.array(day.zenith)
    # Clouds lie on a plane far above, so they shrink towards the horizon.
    size = 512
    field = materials.noise(rng, (size, size), 110, 6)
    distance = 1 / np.clip(rise + 0.07, 0.07, None)
    u = (rays[..., 0] * distance * 62 + size / 2).astype(np.float32)
    v = (rays[..., 1] * distance * 62 + size / 2).astype(np.float32)
    cover = cv2.remap(field, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    threshold = 1.1 - 2.2 * day.cloudiness
    cloud = np.clip((cover - threshold) / 1.6, 0, 0.92)[..., None] * np.clip(rise * 6, 0.25, 1)[..., None]
    shading = (1 - 0.10 * np.clip(cover - threshold - 0.5, 0, 2))[..., None]
    colours = colours * (1 - cloud) + np.array(day.clouds) * shading * cloud
    grown = cv2.resize(colours.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR)
    if day.lamps >= 1:
        for _ in range(90):
            at = (int(rng.integers(width)), int(rng.integers(height // 2)))
            grown[at[1], at[0]] += float(rng.uniform(20, 120))
    return materials.bounded(grown)


def hazed(colours: Pixels, closeness: npt.NDArray[np.float32], day: Daylight) -> Pixels:
    """Blend distant pixels with the colour of the horizon; `closeness` is 1/depth in 1/m."""
    seen = np.empty_like(colours)
    for band in materials.bands(len(colours)):
        depth = 1 / np.maximum(closeness[band], 1e-3)
        veil = 1 - np.exp(-day.haze * np.maximum(depth - 4, 0))
        share = np.where(closeness[band] > 0, veil, 0).astype(np.float32)[..., None]
        seen[band] = materials.bounded(colours[band] * (1 - share) + np.array(day.horizon, np.float32) * share)
    return seen


@functools.lru_cache(maxsize=4)
def _vignette(height: int, width: int) -> npt.NDArray[np.float32]:
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j].astype(np.float32)
    return np.asarray(1 - 0.13 * (x * x + y * y) ** 1.3, np.float32)


def developed(colours: Pixels, day: Daylight, rng: np.random.Generator, *, bright: float = 1.0) -> Pixels:
    """Add the camera's effects: bloom around lamps, vignetting, grain."""
    height, width = colours.shape[:2]
    image = colours.astype(np.float32) * bright
    if day.lamps > 0:
        glare = np.clip(image - 205, 0, None)
        small = cv2.resize(glare, (max(2, width // 4), max(2, height // 4)), interpolation=cv2.INTER_AREA)
        image += cv2.resize(cv2.GaussianBlur(small, (0, 0), max(1.0, width / 120)), (width, height)) * 1.6
    image *= _vignette(height, width)[..., None]
    image += rng.standard_normal(image.shape, np.float32) * day.grain
    return materials.bounded(image)
