"""Images in forms that no library here writes: by hand after their specifications, or kept as they came from a tool."""

import base64
import io
import struct
import zlib

import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage

from worker.images import png

Pixels = npt.NDArray[np.uint8]

# First column and row, and steps between columns and rows, of the seven passes (PNG, third edition, section 8.2).
_ADAM7 = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}  # of a PNG, by the number of its channels
_RAW, _JPEG, _DEFLATE = 1, 7, 8  # compressions of a TIFF


def run_length_bmp() -> bytes:
    """A BMP of 64 x 64 palette indices, run-length encoded: a run for every row."""
    rows = b"".join(bytes((64, row, 0, 0)) for row in range(64)) + b"\x00\x01"
    palette = b"".join(bytes((value, value, value, 0)) for value in range(256))
    head = struct.pack("<IiiHHIIiiII", 40, 64, 64, 1, 8, 1, len(rows), 0, 0, 256, 0)
    start = 14 + len(head) + len(palette)
    return b"BM" + struct.pack("<IHHI", start + len(rows), 0, 0, start) + head + palette + rows


def interlaced_png(pixels: Pixels) -> bytes:
    """A PNG in seven passes (Adam7), of pixels of shape (height, width, 1 to 4 channels)."""
    height, width, channels = pixels.shape
    passes = (pixels[top::down, left::right] for left, top, right, down in _ADAM7)
    rows = b"".join(b"\x00" + row.tobytes() for part in passes if part.size for row in part)
    header = struct.pack(">IIBBBBB", width, height, 8, _COLOUR_TYPES[channels], 0, 0, 1)
    parts = ((b"IHDR", header), (b"IDAT", zlib.compress(rows)), (b"IEND", b""))
    return png.SIGNATURE + b"".join(png.chunk(kind, content) for kind, content in parts)


def tiled_tiff(
    pixels: Pixels, compression: str = "raw", *, planar: bool = False, side: tuple[int, int] = (64, 32)
) -> bytes:
    """A TIFF in tiles (TIFF 6.0, section 15), of pixels of shape (height, width, 1 or 3 channels).

    Parameters
    ----------
    pixels : uint8
    compression : str
        ``raw``, ``deflate``, or ``jpeg`` (of one channel).
    planar : bool
        Each channel in tiles of its own.
    side : pair of int
        Width and height of a tile, multiples of 16. Tiles at the right and lower edges are filled up.
    """
    height, width, channels = pixels.shape
    across, down = side
    full = np.pad(pixels, ((0, -height % down), (0, -width % across), (0, 0)), mode="edge")
    planes = [full[..., channel : channel + 1] for channel in range(channels)] if planar else [full]
    tiles = [
        _compressed(plane[top : top + down, left : left + across], compression)
        for plane in planes
        for top in range(0, height, down)
        for left in range(0, width, across)
    ]
    code = {"raw": _RAW, "deflate": _DEFLATE, "jpeg": _JPEG}[compression]
    fields: dict[int, tuple[int, ...]] = {
        256: (width,), 257: (height,), 258: (8,) * channels, 259: (code,), 262: (2 if channels == 3 else 1,),
        277: (channels,), 284: (2 if planar else 1,), 322: (across,), 323: (down,), 324: (),
        325: tuple(map(len, tiles)),
    }  # fmt: skip
    values_at = 8 + 2 + 12 * len(fields) + 4
    tiles_at = values_at + 4 * sum(len(value) for value in (*fields.values(), tiles) if len(value) > 1)
    fields[324] = tuple(tiles_at + sum(map(len, tiles[:number])) for number in range(len(tiles)))
    directory, values = struct.pack("<H", len(fields)), b""
    for tag, numbers in fields.items():
        packed = struct.pack(f"<{len(numbers)}I", *numbers)
        if tag == 258:  # shorts, as every reader expects of this field
            packed = struct.pack(f"<{len(numbers)}H", *numbers)
        place = packed.ljust(4, b"\x00") if len(packed) <= 4 else struct.pack("<I", values_at + len(values))
        directory += struct.pack("<HHI", tag, 3 if tag == 258 else 4, len(numbers)) + place
        values += packed if len(packed) > 4 else b""
    head = b"II" + struct.pack("<HI", 42, 8) + directory + bytes(4) + values
    return head.ljust(tiles_at, b"\x00") + b"".join(tiles)


def _compressed(tile: Pixels, compression: str) -> bytes:
    if compression == "raw":
        return tile.tobytes()
    if compression == "deflate":
        return zlib.compress(tile.tobytes())
    out = io.BytesIO()
    PilImage.fromarray(tile[..., 0]).save(out, "JPEG")
    return out.getvalue()


def arithmetic_jpegs() -> dict[str, bytes]:
    """A drawn picture of 48 x 32 pixels in JPEGs with arithmetic coding (T.81, annex D), by the kind of their scans.

    Pillow wrote the picture, `jpegtran -arithmetic` of libjpeg-turbo coded its coefficients anew.
    """
    return {name: base64.b64decode(text) for name, text in _ARITHMETIC.items()}


_ARITHMETIC = {
    "arithmetic": (
        "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1RV19iZ2hnPk1x"
        "eXBkeFxlZ2P/2wBDARESEhgVGC8aGi9jQjhCY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2P/yQAR"
        "CAAgADADASIAAhEBAxEB/8wACgAQEAUBEBEF/9oADAMBAAIRAxEAPwDSW01p2ROjjHOhcNp9ys3+jkMiT2v1UoEVc/InZSwHRNCJ1Dp+ZRic"
        "ViXFm323ph7DdGnF8U6XA/8Aw5ijqaQxKp42RBwa10/cQ0eYnCa9OE/Oa6lkt6SNYz+6yDLhMD/jXthaE4ZcwZnoKXqvvdk0wgW7XP3b7fUD"
        "zzE0Ho6O+mzkiThPw0bSJFU8m1OB3H4Lo0JP2GSBz1TYydKdWWg9WiCMc2wqIc0M3+jxT0cg3KKdxaAfCumxNR3mJUvdhlnCFvDh8zQAX8U7"
        "s7M5KyeMcScfgA+1Mfc48/mTCnEDknq5253ZhkTSU2+B/bcx8ZezQ6eGN8x4RHsuyvZwHUuhjGlWIbJBuy30mwNuYzAzyxaEIBSuYoXgNdtG"
        "GUmsAt20zwyQK2rugoNw+JQM/9k="
    ),
    "progressive": (
        "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1RV19iZ2hnPk1x"
        "eXBkeFxlZ2P/2wBDARESEhgVGC8aGi9jQjhCY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2P/ygAR"
        "CAAgADADASIAAhEBAxEB/8wABgAQARD/2gAMAwEAAhADEAAAAdG6iXM+a0NWSHg06hiOUw/Gn3RtrFMbkoTwqP/MAAQQBf/aAAgBAQABBQJL"
        "D4UncF/7wHJRZuZnJzvCVdqYJutlvMqQSRKV/wAExqJviENnDbbI4EFGctM/Mdz/zAAEEQX/2gAIAQMBAT8BETAjnRMRi6UJnKMW3B65RM86"
        "Mb+0h7Jg/8wABBEF/9oACAECAQE/ARFW3AAnQQwjM1gDQzNKlQ6SCNVsLjIWmJF+/8wABBAF/9oACAEBAAY/Aljx3wsqGxiPSuR0C72UWP/M"
        "AAQQBf/aAAgBAQABPyHH1ftqeXEuBWBzQHh1xL6P2LorxewKHpqhncv4dJPr7smD7k8qplqSjd8rirgBQcUp4P/aAAwDAQACAAMAAAAQ7ass"
        "xij/zAAEEQX/2gAIAQMBAT8Qj3Uijqd+VndsPkbHfO0JmvJA/8wABBEF/9oACAECAQE/EOjEjn2Uk5qyzhpZPMSRcfLEIVs+vwg2/8wABBAF"
        "/9oACAEBAAE/EFJ7ycoaS1aVtsjdp2BXcFiuWwOxEhCRWJwgBSwoIvouMg/RcO+qy5pzw7x27ROWi1v3RVMIJR5rJDSvfA/SnFas7krkQ0+D"
        "gP/Z"
    ),
    "restarts": (
        "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABALDA4MChAODQ4SERATGCgaGBYWGDEjJR0oOjM9PDkzODdASFxOQERXRTc4UG1RV19iZ2hnPk1x"
        "eXBkeFxlZ2P/2wBDARESEhgVGC8aGi9jQjhCY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2NjY2P/yQAR"
        "CAAgADADASIAAhEBAxEB/8wACgAQEAUBEBEF/90ABAAD/9oADAMBAAIRAxEAPwDSW01p2ROjjHOhcNp9ys3+jkMiT2v1UoEVc/InZSwHRNCJ"
        "1Dp+ZRicViXFm323ph7DdGnF8U6XA/8Aw5ijqaQxKp42RBwa10/cQ0eYnCa9OE/Oa6lkt6SNYz+6yDLhMD/jXthaE4ZcwZnoKXqvvdk0wgW7"
        "XP3b7fUDzzE0Ho6O+mzkiThPw0bSJFU8m1OB3H4Lo0JP2GSBz1TYydKdWWg9gP/Q/wA+Nvr9zlTJ9ZgTv/u2LcyFo88SL5eIZZTHAKbctXPC"
        "XRG5MCpLLkaIoxCN62P/AL8YHp6IlsxZul8rglDBHL+/4z3d8VcdJ4gNACccxBXazL93AeRc3dR8W4yAuL3lhn0GJr0Btk0iFOUt5DS7rujA"
        "PlpAxIDSETvJx0F6O8R4bBz1dw80h1ZOCVcz5I0fzT9Uq0Fzd1pS+ws3wP/Z"
    ),
}
