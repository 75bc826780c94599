"""Images as ROS carries them, as image files that the service takes."""

import struct

CHANNELS = {
    "rgb8": (3, (2, 1, 0)),
    "bgr8": (3, (0, 1, 2)),
    "rgba8": (4, (2, 1, 0)),
    "bgra8": (4, (0, 1, 2)),
    "mono8": (1, (0,)),
    "8UC1": (1, (0,)),
    "8UC3": (3, (0, 1, 2)),
}
"""Bytes of a pixel, and which of them are blue, green and red; by `sensor_msgs/Image.encoding`."""

HEADER = 14 + 40
"""Bytes of the headers of a BMP file."""


class Unusable(ValueError):
    """An image that cannot be sent: what it is, and what to do."""


def as_file(encoding: str, width: int, height: int, step: int, data: bytes) -> bytes:
    """Pixels without compression as a BMP file, lossless.

    Parameters
    ----------
    encoding : str
        A key of `CHANNELS`; alpha is left out.
    width, height : int
    step : int
        Bytes from one row to the next, at least those of its pixels.
    data : bytes

    Raises
    ------
    Unusable
    """
    if encoding not in CHANNELS:
        raise Unusable(f"images come as {encoding!r}: {_remedy(encoding)}")
    size, order = CHANNELS[encoding]
    used = width * size
    if width < 1 or height < 1 or step < used or len(data) < step * (height - 1) + used:
        raise Unusable(
            f"an image of {width} x {height} in {encoding} with a step of {step} holds {len(data)} bytes, which does "
            "not add up: look at the camera's driver"
        )
    rows = (data[start : start + used] for start in range(step * (height - 1), -1, -step))  # a BMP begins at the bottom
    gap = b"\0" * (-width * len(order) % 4)
    body = b"".join(_ordered(row, size, order) + gap for row in rows)
    palette = b"".join(bytes((grey, grey, grey, 0)) for grey in range(256)) if len(order) == 1 else b""
    start = HEADER + len(palette)
    return (
        struct.pack("<2sIHHI", b"BM", start + len(body), 0, 0, start)
        + struct.pack("<IiiHHIIiiII", 40, width, height, 1, 8 * len(order), 0, len(body), 2835, 2835, 0, 0)
        + palette
        + body
    )


def _ordered(row: bytes, size: int, order: tuple[int, ...]) -> bytes:
    """The bytes of each pixel in the order of a BMP: blue, green, red."""
    if tuple(range(size)) == order:
        return row
    ordered = bytearray(len(row) // size * len(order))
    for place, source in enumerate(order):
        ordered[place :: len(order)] = row[source::size]
    return bytes(ordered)


def _remedy(encoding: str) -> str:
    kind = encoding.lower()
    if "16" in kind or "32" in kind or "64" in kind:
        return "depth, thermal and 16-bit images show no place as colours do; give the topic of the colour camera"
    if kind.startswith("bayer"):
        return "run image_proc's debayer node, and give the topic of its colours"
    return f"have the driver, or image_transport's republish, send {', '.join(sorted(CHANNELS))} or compressed images"


def checked(form: str, data: bytes) -> bytes:
    """The bytes of a `sensor_msgs/CompressedImage`, which is an image file already.

    Parameters
    ----------
    form : str
        Its ``format``: ``jpeg``, ``png``, ``rgb8; jpeg compressed bgr8``, ...
    data : bytes

    Raises
    ------
    Unusable
        A depth image, one of 16 bits or none at all. Everything else is judged by the service.
    """
    pixels = form.partition(";")[0].strip()
    if "compressedDepth" in form or (";" in form and "16" in pixels) or "32F" in pixels:
        raise Unusable(f"compressed images come as {form!r}: {_remedy('16')}")
    if not data:
        raise Unusable("a compressed image holds no bytes: look at the camera's driver")
    return data
