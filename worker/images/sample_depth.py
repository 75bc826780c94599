"""Sixteen-bit samples as eight, by as many bits as a camera fills of them."""

import io
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage
from PIL.ImageFile import ImageFile

from schemas.image import Bytes2D
from worker.images import png, tiff

Samples = npt.NDArray[np.uint16]

USUAL = (10, 12, 14)
"""Bits of sensors whose values are written into sixteen as they are."""

DIM = 128
"""Below this are all upper eight bits where one bit or more of sixteen is not filled."""

PARTS = 64
"""Of an image that are looked at one after another, which takes less memory."""

_BITS, _COLOURS, _MOST, _RANGE = 258, 262, 281, 341  # tags of a TIFF: BitsPerSample to SMaxSampleValue
_WHITE_IS_ZERO = 0
_PLANAR, _APART = 284, 2
_SWAPPED = {"L": "B", "B": "L", "N": "B" if np.little_endian else "L"}  # orders of bytes


def grey(samples: Samples, data: bytes) -> Bytes2D:
    """Grey samples of a PNG or TIFF as eight bits, of the same shape.

    Parameters
    ----------
    samples : uint16 of shape (height, width)
    data : bytes
        The encoded image, which may say how many bits of them count.
    """
    made = _eight(samples.__getitem__, samples.shape, data)
    return ~made if _tags(data).get(_COLOURS) == _WHITE_IS_ZERO else made


def colours(upper: Bytes2D, data: bytes) -> Bytes2D:
    """RGB as eight bits: `upper`, unless the image has sixteen and they are not filled.

    Parameters
    ----------
    upper : uint8 of shape (height, width, 3)
        The upper eight bits of the image, or all that it has.
    data : bytes
        The encoded image.
    """
    if not _has_sixteen(data) or int(upper.max()) >= DIM:
        return upper
    if data.startswith(png.SIGNATURE):
        flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
        samples = np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), flags), np.uint16)
        return _eight(samples.__getitem__, samples.shape, data)
    lower = _lower(data)
    if lower is None or lower.shape != upper.shape:
        return upper

    def joined(rows: slice) -> Samples:
        return np.asarray(upper[rows].astype(np.uint16) << 8 | lower[rows], np.uint16)

    return _eight(joined, upper.shape, data)


def beside_alpha(upper: PilImage.Image, data: bytes) -> PilImage.Image:
    """RGBA whose colours are those of `colours`, and whose alpha stays; `upper` as there."""
    if not _has_sixteen(data):
        return upper
    pixels = np.array(upper)
    pixels[..., :3] = colours(pixels[..., :3], data)
    return PilImage.fromarray(pixels)


def mend_planes(pil_image: PilImage.Image) -> None:
    """Before an image is loaded: of a TIFF whose colours lie apart, not compressed, Pillow takes sixteen bits for two
    samples of eight."""
    tags: Any = getattr(pil_image, "tag_v2", {})
    if set(tags.get(_BITS, ())) == {16} and isinstance(pil_image, ImageFile):
        suffix = ";16L" if tags.prefix == b"II" else ";16B"
        tiles = [(tile, *_raw(tile)) for tile in pil_image.tile]
        pil_image.tile = [
            tile._replace(args=(raw + suffix, *others)) if tile.codec_name == "raw" and len(raw) == 1 else tile
            for tile, raw, others in tiles
        ]


def _lower(data: bytes) -> Bytes2D | None:
    """The lower eight bits of an RGB TIFF, which Pillow takes for the upper ones in the other order of bytes."""
    with PilImage.open(io.BytesIO(data), formats=["TIFF"]) as pil_image:
        mend_planes(pil_image)
        if _tags(data).get(_PLANAR) == _APART and any(tile.codec_name == "libtiff" for tile in pil_image.tile):
            return _lower_of_planes(data)
        tiles = []
        for tile in pil_image.tile:
            raw, others = _raw(tile)
            if ";16" not in raw or raw.startswith("RGBa"):  # colours that alpha was multiplied into are divided by it
                return None
            tiles.append(tile._replace(args=(raw[:-1] + _SWAPPED[raw[-1]], *others)))
        pil_image.tile = tiles
        return np.asarray(pil_image)[..., :3]


def _lower_of_planes(data: bytes) -> Bytes2D | None:
    """The same where the colours lie apart and are compressed: Pillow takes the upper ones whatever it is told."""
    lower = []
    try:
        for number in range(3):
            plane = io.BytesIO(tiff.plane(data, number))
            with PilImage.open(plane, formats=["TIFF"]) as pil_image:
                lower.append((np.asarray(pil_image) & 0xFF).astype(np.uint8))
    except (ValueError, LookupError, OSError, struct.error):
        return None
    return np.dstack(lower)


def _raw(tile: Any) -> tuple[str, tuple[Any, ...]]:
    """How the samples of a tile lie, as Pillow names it, and the decoder's other arguments."""
    raw, *others = tile.args if isinstance(tile.args, tuple) else (tile.args,)
    return raw, tuple(others)


def _eight(samples: Callable[[slice], Samples], shape: tuple[int, ...], data: bytes) -> Bytes2D:
    """The samples as eight bits; `samples` gives some rows of them."""
    step = -(-shape[0] // PARTS)
    parts = [slice(at, at + step) for at in range(0, shape[0], step)]
    left_out = _filled(lambda: map(samples, parts), data) - 8
    made = np.empty(shape, np.uint8)
    for rows in parts:
        made[rows] = samples(rows) >> left_out
    return made


def _filled(parts: Callable[[], Iterable[Samples]], data: bytes) -> int:
    """How many bits the samples fill, 8 to 16: as the file says where that can be, else the fewest of `USUAL`.

    By that guess a dim image comes out brighter than it is, and no brighter than one that is exposed well.
    """
    tags = _tags(data)
    bits = int(tags.get(_BITS, (16,))[0])
    if bits < 16:
        return bits
    most = max(int(part.max()) for part in parts())
    said = _said_by_tiff(tags, most) if tags else _said_by_png(data)
    choices: Sequence[int] = USUAL if said is None else (said,)
    return next((bits for bits in choices if most < 1 << bits and _finer(parts, bits)), 16)


def _finer(parts: Callable[[], Iterable[Samples]], bits: int) -> bool:
    """Whether samples of so many bits were not scaled to sixteen: the lowest bits of dim ones would be 0 or 1 then, or
    they would be multiples of what eight bits are."""
    if bits >= 15:
        return False
    between = (1 << 16 - bits) - 1  # mostly the first part tells
    return any(np.any(part & between > 1) for part in parts()) and any(np.any(part % 257) for part in parts())


def _said_by_png(data: bytes) -> int | None:
    """Of how many bits the samples were made (sBIT); they should be scaled to sixteen, and not all are."""
    said = next((content for kind, content in png.chunks(data) if kind == b"sBIT"), b"")
    return max(8, *said) if said else None


def _said_by_tiff(tags: dict[int, Any], most: int) -> int | None:
    """Bits of the largest sample that the file says it may have, or has."""
    said = tags.get(_RANGE, tags.get(_MOST))
    values = [int(value) for value in (said if isinstance(said, tuple) else (said,)) if isinstance(value, int | float)]
    return max(8, max(values).bit_length()) if values and most <= max(values) else None


def _has_sixteen(data: bytes) -> bool:
    """Whether each sample of a PNG or TIFF has sixteen bits; False for other images."""
    if data.startswith(png.SIGNATURE):
        return png.depth(data) == 16
    return set(_tags(data).get(_BITS, ())) == {16}


def _is_tiff(data: bytes) -> bool:
    return data.startswith((b"II*\x00", b"MM\x00*"))


def _tags(data: bytes) -> dict[int, Any]:
    """Fields of a TIFF's first page; of another image none."""
    if not _is_tiff(data):
        return {}
    with PilImage.open(io.BytesIO(data), formats=["TIFF"]) as pil_image:
        return dict(getattr(pil_image, "tag_v2", {}))
