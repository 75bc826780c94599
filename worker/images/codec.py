"""Bytes to images and back, within limits; the only module that decodes bytes from clients.

The order matters: type by magic bytes, size from the header, completeness by structure, and only then the decoder.
Plain RGB and grey JPEG and PNG are decoded by OpenCV, which is faster; all others (alpha, palette, CMYK, other depths)
by Pillow.
"""

import hashlib
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from PIL import Image as PilImage

from schemas.errors import BadImage, BodyTooLarge
from schemas.image import Bytes2D, Image, ImageFacts
from schemas.settings import MEGA, Settings
from worker.images.sniffing import ACCEPTED, image_type

# `decode` checks the size against `Limits` first; Pillow's own limit would only add a warning.
PilImage.MAX_IMAGE_PIXELS = None

SHORTEST_SIDE = 32
"""Smallest side accepted, in pixels."""

_ORIENTATION = 0x0112  # EXIF tag
_TURNED = range(5, 9)  # values that swap width and height
_THUMBNAIL_QUALITY = 85
_QUICKER = ("jpeg", "png")  # by OpenCV; not WebP, of which it returns damaged files too
_PLAIN_MODES = ("RGB", "L")  # what OpenCV decodes exactly as Pillow would


@dataclass(frozen=True)
class Limits:
    """Limits of an image's size.

    Parameters
    ----------
    max_bytes : int
        Length of the encoded bytes.
    max_pixels : int
        Width times height, from the header.
    """

    max_bytes: int = 25 * MEGA
    max_pixels: int = 50 * MEGA

    @classmethod
    def of(cls, settings: Settings) -> "Limits":
        """The limits in the settings."""
        return cls(round(settings.max_body_mb * MEGA), round(settings.max_megapixels * MEGA))


def decode(data: bytes, limits: Limits) -> Image:
    """Decode an image: upright, RGB, eight bits.

    Orientation follows EXIF. Grey is repeated, alpha is laid over white, sixteen bits keep their upper eight, CMYK is
    converted without a profile, and of several pages or frames in JPEG, PNG and TIFF the first is taken.

    Raises
    ------
    BadImage
        ``not-a-picture``, ``undecodable-picture``, ``picture-too-large`` or ``picture-too-small``.
    BodyTooLarge
    """
    header = _Header.read(data, limits)
    pixels = _with_opencv(data, header) if header.plain else _with_pillow(data, header)
    return Image(pixels, hashlib.sha256(data).hexdigest(), header.format, len(data))


def probe(data: bytes, limits: Limits) -> ImageFacts:
    """Facts of an image from its header, without decoding; raises as `decode`, except for damaged pixels."""
    header = _Header.read(data, limits)
    return ImageFacts(header.width, header.height, len(data), header.format, hashlib.sha256(data).hexdigest())


def facts(image: Image) -> ImageFacts:
    """The stored facts of a decoded image."""
    return ImageFacts(image.width, image.height, image.byte_count, image.format, image.digest)


def thumbnail(data: bytes, longest: int) -> bytes:
    """A JPEG of an image that `decode` accepts, upright, its longer side at most `longest`; never enlarged.

    It has no EXIF, so it does not reveal where a photo was taken.
    """
    with PilImage.open(io.BytesIO(data), formats=_FORMATS) as pil_image:
        # A JPEG can be decoded straight to a fraction of its size, which saves most of the time.
        pil_image.draft("RGB", (2 * longest, 2 * longest))
        orientation = _orientation(pil_image, data)
        small = _rgb(pil_image)
    small.thumbnail((longest, longest), PilImage.Resampling.LANCZOS)
    out = io.BytesIO()
    PilImage.fromarray(np.ascontiguousarray(_turned(np.asarray(small), orientation))).save(
        out, "JPEG", quality=_THUMBNAIL_QUALITY
    )
    return out.getvalue()


def shrink(image: Image, longest: int = 640) -> Image:
    """The image with its longer side at most `longest`, for drawing on; it keeps its digest and is never enlarged."""
    scale = longest / max(image.width, image.height)
    if scale >= 1:
        return image
    size = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
    pixels = cv2.resize(image.pixels, size, interpolation=cv2.INTER_AREA)
    return replace(image, pixels=np.asarray(pixels, np.uint8))


_FORMATS = [name.upper() for name in ACCEPTED]


@dataclass(frozen=True)
class _Header:
    """Facts of an encoded image, read without decoding."""

    format: str
    stored: tuple[int, int]  # (width, height) as encoded
    orientation: int
    plain: bool

    @property
    def width(self) -> int:
        return self.stored[self.orientation in _TURNED]

    @property
    def height(self) -> int:
        return self.stored[self.orientation not in _TURNED]

    @classmethod
    def read(cls, data: bytes, limits: Limits) -> "_Header":
        """Check everything that needs no decoding; raises as `decode`."""
        if len(data) > limits.max_bytes:
            raise BodyTooLarge(f"the image has {len(data):,} bytes; at most {limits.max_bytes:,} are taken")
        kind = image_type(data)
        try:
            with PilImage.open(io.BytesIO(data), formats=_FORMATS) as pil_image:
                stored = pil_image.size
                orientation = _orientation(pil_image, data)
                animated = kind == "webp" and getattr(pil_image, "n_frames", 1) > 1
                plain = kind in _QUICKER and pil_image.mode in _PLAIN_MODES and "transparency" not in pil_image.info
        except Exception as error:
            # Pillow's parsers raise errors of struct, zlib and others; the type is already checked.
            raise _undecodable(kind, f"its header cannot be read ({error})") from error
        if animated:
            raise BadImage("not-a-picture", "this is an animated WebP; send a still image")
        _check_size(*stored, limits)
        whole = _WHOLE.get(kind)
        if whole is not None and not whole(data):
            raise _undecodable(kind, "the file ends too early")
        return cls(kind, stored, orientation, plain)


def _check_size(width: int, height: int, limits: Limits) -> None:
    if width * height > limits.max_pixels:
        raise BadImage(
            "picture-too-large",
            f"the image is {width} x {height} = {width * height / MEGA:.1f} megapixels; "
            f"at most {limits.max_pixels / MEGA:g} are taken",
        )
    if min(width, height) < SHORTEST_SIDE:
        raise BadImage(
            "picture-too-small",
            f"the image is {width} x {height} pixels; at least {SHORTEST_SIDE} x {SHORTEST_SIDE} are needed",
        )


def _orientation(pil_image: PilImage.Image, data: bytes) -> int:
    """EXIF orientation, 1 to 8; 1 when it is missing or unreadable. Decodes no pixels."""
    if pil_image.format == "TIFF":
        return 1  # Pillow applies it by itself
    try:
        if pil_image.format == "PNG":
            # Pillow's own reader of a PNG's EXIF decodes the image, since the chunk may follow the pixels.
            for kind, content in _png_chunks(data):
                if kind == b"eXIf":
                    pil_image.info["exif"] = b"Exif\x00\x00" + content
            value = PilImage.Image.getexif(pil_image).get(_ORIENTATION, 1)
        else:
            value = pil_image.getexif().get(_ORIENTATION, 1)
    except Exception:
        # Broken EXIF is common in real photos and no reason to refuse the pixels.
        return 1
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


# OpenCV fills the rest of a damaged JPEG with this grey, where Pillow raises. When the last block has exactly this
# grey, which hardly any intact image has, Pillow decodes the image too.
_UNWRITTEN = 128


def _with_opencv(data: bytes, header: _Header) -> Bytes2D:
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise _undecodable(header.format, "it is damaged") from error
    if pixels is None or pixels.shape[1::-1] != header.stored:
        raise _undecodable(header.format, "it is damaged")
    if header.format == "jpeg" and (pixels[-8:, -8:] == _UNWRITTEN).all():
        _with_pillow(data, header)
    return np.ascontiguousarray(_turned(pixels, header.orientation))


def _turned(pixels: Bytes2D, orientation: int) -> Bytes2D:
    """Undo an EXIF orientation: 2 to 4 mirror or turn by 180 degrees, 5 to 8 also swap rows and columns."""
    if orientation in _TURNED:
        pixels = pixels.transpose(1, 0, 2)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels


def _with_pillow(data: bytes, header: _Header) -> Bytes2D:
    try:
        with PilImage.open(io.BytesIO(data), formats=_FORMATS) as pil_image:
            pil_image.load()
            upright = _rgb(pil_image)
    except BadImage:
        raise
    except Exception as error:
        raise _undecodable(header.format, f"it is damaged ({error})") from error
    return np.ascontiguousarray(_turned(np.asarray(upright), header.orientation))


def _rgb(pil_image: PilImage.Image) -> PilImage.Image:
    """Convert any mode of grey or colour to eight-bit RGB; raises BadImage for 32-bit pixels."""
    if pil_image.mode.startswith("I;16"):
        return PilImage.fromarray((np.asarray(pil_image) >> 8).astype(np.uint8)).convert("RGB")
    if pil_image.mode in ("I", "F"):
        # 32-bit pixels have no defined white level.
        raise BadImage(
            "undecodable-picture", "its pixels are 32-bit numbers without a known range; convert it to 8 or 16 bits"
        )
    if pil_image.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in pil_image.info:
        alpha = pil_image.convert("RGBA")
        return PilImage.alpha_composite(PilImage.new("RGBA", alpha.size, "white"), alpha).convert("RGB")
    return pil_image.convert("RGB")


# A marker other than a stuffed zero, a restart or a fill byte ends entropy-coded data.
_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
_END_OF_IMAGE = 0xD9
# Segments before it: tables, frames, scans, application data, comments. Any other marker is damage, at which OpenCV
# would stop and return an incomplete image.
_SEGMENTS = frozenset({*range(0xC0, 0xD0), *range(0xDA, 0xDE), *range(0xE0, 0xF0), 0xFE} - {0xC8})


def _jpeg_is_whole(data: bytes) -> bool:
    """Whether known segments follow one another up to the end-of-image marker of the image itself.

    Decoders fill missing data with grey. Searching for the marker alone is not enough: the thumbnail in the EXIF block
    has one too.
    """
    at = 2
    while match := _MARKER.search(data, at):
        marker = data[match.end() - 1]
        if marker == _END_OF_IMAGE:
            return True
        if marker not in _SEGMENTS:
            return False
        length = int.from_bytes(data[match.end() : match.end() + 2], "big")
        at = match.end() + max(length, 2)
    return False


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Type and content of a PNG's chunks, in order, up to IEND or the end of an incomplete file."""
    at = 8
    while at + 12 <= len(data):
        kind, length = data[at + 4 : at + 8], int.from_bytes(data[at : at + 4], "big")
        yield kind, data[at + 8 : at + 8 + length]
        if kind == b"IEND":
            return
        at += 12 + length


def _png_is_whole(data: bytes) -> bool:
    """Whether the chunks are complete up to IEND."""
    return any(kind == b"IEND" for kind, _ in _png_chunks(data))


def _webp_is_whole(data: bytes) -> bool:
    """Whether the file has the length in its RIFF header."""
    return len(data) >= 8 + int.from_bytes(data[4:8], "little")


_WHOLE = {"jpeg": _jpeg_is_whole, "png": _png_is_whole, "webp": _webp_is_whole}


def _undecodable(kind: str, why: str) -> BadImage:
    return BadImage("undecodable-picture", f"this {kind} image cannot be decoded: {why}")
