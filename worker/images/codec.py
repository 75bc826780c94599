"""Bytes to images and back, within limits; the only module that decodes bytes from clients.

The order matters: type by magic bytes, completeness by structure, size from the header, and only then the decoder.
RGB and grey JPEG are decoded by simplejpeg, which reports damage that others pass over; such PNG by OpenCV, which is
faster; all others (alpha, palette, CMYK, other depths) by Pillow.
"""

import hashlib
import io
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import cv2
import numpy as np
import simplejpeg
from PIL import Image as PilImage, UnidentifiedImageError
from PIL.TiffImagePlugin import TiffImageFile

from schemas.errors import BadImage, BodyTooLarge, RevisitError
from schemas.image import Bytes2D, Image, ImageFacts
from worker.images import jpeg, png, sample_depth
from worker.images.sniffing import ACCEPTED, image_type

if TYPE_CHECKING:  # a decoder's process does without the libraries of settings
    from schemas.settings import Settings

MEGA = 1_000_000

# `decode` checks the size against `Limits` first; Pillow's own limit would only add a warning.
PilImage.MAX_IMAGE_PIXELS = None

SHORTEST_SIDE = 32
"""Smallest side accepted, in pixels."""

LONGEST_SIDE = 65_500
"""Longest side accepted, in pixels: that of a JPEG, in which images are given again."""

NARROWEST = 50
"""How many times as long as wide an image may be. Panoramas and strips are below 20; nothing is found in a thread."""

_TOO_LARGE = "picture-too-large"
_ORIENTATION = 0x0112  # EXIF tag
_TILE_SIDES = (322, 323)  # tags of a TIFF: width and length of a tile
_TURNED = range(5, 9)  # values that swap width and height
_THUMBNAIL_QUALITY = 85
_QUICKER = ("jpeg", "png")  # not by Pillow; not WebP, of which OpenCV returns damaged files too
_PLAIN_MODES = ("RGB", "L")  # what the quicker decoders decode exactly as Pillow would


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
    def of(cls, settings: "Settings") -> "Limits":
        """The limits in the settings."""
        return cls(round(settings.max_body_mb * MEGA), round(settings.max_megapixels * MEGA))

    @classmethod
    def that_allow(cls, data: bytes) -> "Limits":
        """The lowest limits that an image is within, of which only the header is read; raises BadImage."""
        known = probe(data, cls(len(data), LONGEST_SIDE**2))
        return cls(len(data), known.width * known.height)


def decode(data: bytes, limits: Limits) -> Image:
    """Decode an image: upright, RGB, eight bits.

    Orientation follows EXIF. Grey is repeated, alpha is laid over white (that of a BMP only where it is not 0 all
    over), CMYK is converted without a profile. Of sixteen bits the upper eight are kept, of those that are filled
    (`sample_depth`). Of several pages or frames in JPEG, PNG and TIFF the first is taken, in HEIC the primary one.

    Raises
    ------
    BadImage
        ``not-a-picture``, ``undecodable-picture``, ``picture-too-large`` or ``picture-too-small``.
    BodyTooLarge
    """
    pixels, form = decode_pixels(data, limits)
    return Image(pixels, hashlib.sha256(data).hexdigest(), form, len(data))


def decode_pixels(data: bytes, limits: Limits, into: Bytes2D | None = None) -> tuple[Bytes2D, str]:
    """The pixels of shape (height, width, 3) and the format's name; otherwise as `decode`.

    `into` is flat memory in which they may end up, where that saves a copy.
    """
    header = _Header.read(data, limits)
    if header.format == "jpeg":
        pixels = _with_simplejpeg(data, header, into)
    elif not header.plain:
        pixels = _with_pillow(data, header)
    else:
        pixels = _with_opencv(data, header)
    return np.ascontiguousarray(_turned(pixels, header.orientation)), header.format


def probe(data: bytes, limits: Limits) -> ImageFacts:
    """Facts of an image from its header, without decoding; raises as `decode`, except for damaged pixels."""
    header = _Header.read(data, limits)
    return ImageFacts(header.width, header.height, len(data), header.format, hashlib.sha256(data).hexdigest())


def facts(image: Image) -> ImageFacts:
    """The stored facts of a decoded image."""
    return ImageFacts(image.width, image.height, image.byte_count, image.format, image.digest)


def orientation(data: bytes) -> int:
    """The orientation by which `decode` turns an image, 1 to 8; 1 for TIFF and HEIC, which Pillow turns by itself."""
    with PilImage.open(io.BytesIO(data), formats=_FORMATS) as pil_image:
        return _orientation(pil_image, data)


def thumbnail(data: bytes, longest: int) -> bytes:
    """A JPEG of an image that `decode` accepts, upright, its longer side at most `longest`; never enlarged.

    It has no EXIF, so it does not reveal where a photo was taken.
    """
    structure = None
    if image_type(data) == "jpeg":
        with suppress(ValueError):  # of more segments than are taken now
            structure = jpeg.Structure.read(data)
    whole = data if structure is None else jpeg.ended(data, structure)
    with PilImage.open(io.BytesIO(whole), formats=_FORMATS) as pil_image:
        # A JPEG can be decoded straight to a fraction of its size, which saves most of the time.
        pil_image.draft("RGB", (2 * longest, 2 * longest))
        orientation = _orientation(pil_image, data)
        sample_depth.mend_planes(pil_image)
        small = _rgb(pil_image, data)
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


_FORMATS = ["HEIF" if name == "heic" else name.upper() for name in ACCEPTED]


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
        check_length(data, limits)
        kind = image_type(data)
        ended = _is_whole(kind, data)
        try:
            with PilImage.open(io.BytesIO(data), formats=_FORMATS) as pil_image:
                stored = pil_image.size
                orientation = _orientation(pil_image, data)
                animated = kind == "webp" and getattr(pil_image, "n_frames", 1) > 1
                tile = _tile(pil_image)
                plain = kind in _QUICKER and pil_image.mode in _PLAIN_MODES and "transparency" not in pil_image.info
        except UnidentifiedImageError as error:
            raise _undecodable(kind, "its header is damaged, or of a variant that is not read") from error
        except Exception as error:
            # Pillow's parsers raise errors of struct, zlib and others; the type is already checked.
            raise _undecodable(kind, f"its header cannot be read ({error})") from error
        if animated:
            raise BadImage("not-a-picture", "this is an animated WebP; send a still image")
        _check_size(*stored, limits)
        if tile[0] * tile[1] > max(limits.max_pixels, MEGA):
            raise _undecodable(kind, f"it says that its tiles have {tile[0]} x {tile[1]} pixels")
        if kind == "png" and png.is_animated(data):
            raise BadImage("not-a-picture", "this is an animated PNG; send a still image")
        if not ended:
            raise _undecodable(kind, "the file ends too early")
        return cls(kind, stored, orientation, plain)


def is_too_large(error: RevisitError) -> bool:
    """Whether an image was refused for its size: larger limits may take it."""
    return isinstance(error, BodyTooLarge) or error.code == _TOO_LARGE


def check_length(data: bytes, limits: Limits) -> None:
    """Refuse more bytes than are taken; raises BodyTooLarge."""
    if len(data) > limits.max_bytes:
        raise BodyTooLarge(f"the image has {len(data):,} bytes; at most {limits.max_bytes:,} are taken")


def _check_size(width: int, height: int, limits: Limits) -> None:
    if width * height > limits.max_pixels:
        raise BadImage(
            _TOO_LARGE,
            f"the image is {width} x {height} = {width * height / MEGA:.1f} megapixels; "
            f"at most {limits.max_pixels / MEGA:g} are taken",
        )
    if max(width, height) > LONGEST_SIDE:
        raise BadImage(
            _TOO_LARGE,
            f"the image is {width} x {height} pixels; a side of at most {LONGEST_SIDE:,} is taken",
        )
    if min(width, height) < SHORTEST_SIDE:
        raise BadImage(
            "picture-too-small",
            f"the image is {width} x {height} pixels; at least {SHORTEST_SIDE} x {SHORTEST_SIDE} are needed",
        )
    if max(width, height) > NARROWEST * min(width, height):
        raise BadImage(
            _TOO_LARGE,
            f"the image is {width} x {height} pixels; "
            f"one side may be at most {NARROWEST} times as long as the other: cut it into several images",
        )


def _tile(pil_image: PilImage.Image) -> tuple[int, int]:
    """Width and height of the tiles of a TIFF, which its decoder makes room for; zeros without tiles."""
    if not isinstance(pil_image, TiffImageFile):
        return 0, 0
    width, height = (pil_image.tag_v2.get(tag, 0) for tag in _TILE_SIDES)
    return int(width), int(height)


def _orientation(pil_image: PilImage.Image, data: bytes) -> int:
    """EXIF orientation, 1 to 8; 1 when it is missing or unreadable. Decodes no pixels."""
    if pil_image.format in ("TIFF", "HEIF"):
        return 1  # Pillow applies it by itself
    try:
        if pil_image.format == "PNG":
            # Pillow's own reader of a PNG's EXIF decodes the image, since the chunk may follow the pixels.
            for kind, content in png.chunks(data):
                if kind == b"eXIf":
                    pil_image.info["exif"] = b"Exif\x00\x00" + content
            value = PilImage.Image.getexif(pil_image).get(_ORIENTATION, 1)
        else:
            value = pil_image.getexif().get(_ORIENTATION, 1)
    except Exception:
        # Broken EXIF is common in real photos and no reason to refuse the pixels.
        return 1
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def _with_simplejpeg(data: bytes, header: _Header, into: Bytes2D | None) -> Bytes2D:
    """Decode a JPEG, refusing what libjpeg warns of: a code that does not exist, a scan too short or too long.

    Of single flipped bits in a scan that finds 10 to 40 %; the others give another valid image.
    """
    structure = jpeg.Structure.read(data)
    if structure is None:
        raise _undecodable("jpeg", "the file ends too early, or its segments do not follow one another")
    colors = "RGB" if header.plain else "CMYK"
    room = into if header.plain and into is not None and into.size >= 3 * header.width * header.height else None
    try:
        try:
            whole = jpeg.ended(data, structure)
            pixels = simplejpeg.decode_jpeg(whole, colors, strict=True, buffer=room)
        except ValueError as error:
            if not _PADDED.search(str(error)):
                raise
            # Cameras pad the last scan with zeros; anything else there is what a damaged scan left over.
            whole = jpeg.without_padding(data, structure)
            pixels = simplejpeg.decode_jpeg(whole, colors, strict=True, buffer=room)
    except (ValueError, MemoryError) as error:
        what = "it is of a variant that is not read" if _VARIANT.search(str(error)) else "it is damaged"
        raise _undecodable("jpeg", f"{what} ({str(error).strip()})") from error
    if header.plain:
        if pixels.shape[1::-1] != header.stored:
            raise _undecodable("jpeg", "its headers disagree about its size")
        return np.asarray(pixels, np.uint8)
    return _with_pillow(whole, header)  # which knows inverted inks


_PADDED = re.compile("extraneous bytes before marker 0xd9")
_VARIANT = re.compile("subsampling level|Unsupported color conversion")
"""What the decoder says of sound images: of odd sampling factors, and of grey without loss."""


def _with_opencv(data: bytes, header: _Header) -> Bytes2D:
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise _undecodable(header.format, "it is damaged") from error
    if pixels is None or pixels.shape[1::-1] != header.stored:
        raise _undecodable(header.format, "it is damaged")
    return sample_depth.colours(np.asarray(pixels, np.uint8), data)


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
            sample_depth.mend_planes(pil_image)
            pil_image.load()
            upright = _rgb(pil_image, data)
    except BadImage:
        raise
    except MemoryError as error:
        raise _undecodable(header.format, "it needs more memory than an image may take") from error
    except Exception as error:
        raise _undecodable(header.format, f"it is damaged ({error})") from error
    return np.asarray(upright)


def _rgb(pil_image: PilImage.Image, data: bytes) -> PilImage.Image:
    """Convert any mode of grey or colour to eight-bit RGB; raises BadImage for 32-bit pixels."""
    if pil_image.mode.startswith("I;16"):
        return PilImage.fromarray(sample_depth.grey(np.asarray(pil_image), data)).convert("RGB")
    if pil_image.mode in ("I", "F"):
        # 32-bit pixels have no defined white level.
        raise BadImage(
            "undecodable-picture", "its pixels are 32-bit numbers without a known range; convert it to 8 or 16 bits"
        )
    if pil_image.mode in ("RGBA", "LA", "PA", "RGBa", "La") or "transparency" in pil_image.info:
        alpha = sample_depth.beside_alpha(pil_image.convert("RGBA"), data)
        if pil_image.format == "BMP" and not alpha.getchannel("A").getbbox():
            return alpha.convert("RGB")  # some programs leave the last eight of 32 bits 0, whatever the header says
        return PilImage.alpha_composite(PilImage.new("RGBA", alpha.size, "white"), alpha).convert("RGB")
    if pil_image.mode == "RGB" and pil_image.format in ("PNG", "TIFF"):
        return PilImage.fromarray(sample_depth.colours(np.asarray(pil_image), data))
    return pil_image.convert("RGB")


def _jpeg_is_whole(data: bytes) -> bool:
    """Whether known segments follow one another up to the end; without the end's marker, whether all scans are there.

    Decoders fill missing data with grey. `_with_simplejpeg` finds scans that are not complete.
    """
    structure = jpeg.Structure.read(data)
    if structure is None or not (structure.ended or structure.has_every_scan()):
        return False
    if structure.scans > jpeg.MOST_SCANS:
        raise _undecodable("jpeg", f"it has {structure.scans:,} scans; at most {jpeg.MOST_SCANS} are taken")
    return True


def _webp_is_whole(data: bytes) -> bool:
    """Whether the file has the length in its RIFF header."""
    return len(data) >= 8 + int.from_bytes(data[4:8], "little")


def _is_whole(kind: str, data: bytes) -> bool:
    """Whether a file does not end too early; raises BadImage for one of too many parts."""
    try:
        return kind not in _WHOLE or _WHOLE[kind](data)
    except ValueError as error:
        raise _undecodable(kind, str(error)) from error


_WHOLE = {"jpeg": _jpeg_is_whole, "png": png.is_whole, "webp": _webp_is_whole}


def _undecodable(kind: str, why: str) -> BadImage:
    return BadImage("undecodable-picture", f"this {kind} image cannot be decoded: {why}")
