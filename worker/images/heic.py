"""HEIC (ISO/IEC 23008-12), which phones save, by libheif: Pillow reads it once this module is imported."""

import base64

import pi_heif

BRANDS = frozenset((b"heic", b"heix", b"heim", b"heis"))
"""Of still images in HEVC (23008-12, annex B.4)."""

# One thread, and nothing but the image: previews and depths are not looked at.
pi_heif.options.DECODE_THREADS = 1
pi_heif.options.THUMBNAILS = pi_heif.options.DEPTH_IMAGES = pi_heif.options.AUX_IMAGES = False
pi_heif.register_heif_opener()


def is_heic(data: bytes) -> bool:
    """Whether the file's type names a still image in HEVC, as its own brand or one that it is compatible with."""
    if data[4:8] != b"ftyp":
        return False
    size = min(int.from_bytes(data[:4], "big"), 256)
    others = {data[at : at + 4] for at in range(16, size, 4)}
    return data[8:12] in BRANDS or (data[8:12] == b"mif1" and bool(others & BRANDS))


SMALLEST = base64.b64decode(
    b"AAAAHGZ0eXBoZWljAAAAAG1pZjFoZWljbWlhZgAAAX1tZXRhAAAAAAAAACFoZGxyAAAAAAAAAABwaWN0AAAAAAAAAAAAAAAAAAAAACJpbG9j"
    b"AAAAAERAAAEAAQAAAAABoQABAAAAAAAAABMAAAAjaWluZgAAAAAAAQAAABVpbmZlAgAAAAABAABodmMxAAAAAA5waXRtAAAAAAABAAAA/Wlw"
    b"cnAAAADdaXBjbwAAAHZodmNDAQNwAAAAkAAAAAAAHvAA/P34+AAADwNgAAEAGEABDAH//wNwAAADAJAAAAMAAAMAHroCQGEAAQAqQgEBA3AA"
    b"AAMAkAAAAwAAAwAeoCCBBZbq5Ka5uAhoMCAAAAMDIAAAAwAhYgABAAZEAcFzwIkAAAATY29scm5jbHgAAQANAAaAAAAAFGlzcGUAAAAAAAAA"
    b"QAAAAEAAAAAoY2xhcAAAACAAAAABAAAAIAAAAAH////gAAAAAv///+AAAAACAAAAEHBpeGkAAAAAAwgICAAAABhpcG1hAAAAAAAAAAEAAQWB"
    b"AgMFhAAAABttZGF0AAAADygBrwUY+gLojv+QxhvoIA=="
)
"""A black image of 32 x 32 pixels: Pillow cannot write one to warm a decoder with."""
