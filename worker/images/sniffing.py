"""The type of a file by its first bytes; the name and content type of an upload are not trusted."""

from schemas.errors import BadImage
from worker.images.heic import is_heic

ACCEPTED = ("jpeg", "png", "webp", "bmp", "tiff", "heic")

# Only files that begin with one of these are passed to a decoder.
_IMAGES = (
    (b"\xff\xd8\xff", "jpeg"),
    (b"\x89PNG\r\n\x1a\n", "png"),
    (b"BM", "bmp"),
    (b"II*\x00", "tiff"),
    (b"MM\x00*", "tiff"),
)

_OTHERS = (
    (b"GIF87a", "a GIF"),
    (b"GIF89a", "a GIF"),
    (b"%PDF", "a PDF"),
    (b"\x00\x00\x00\x0cjP  ", "a JPEG 2000 image"),
    (b"\xff\x4f\xff\x51", "a JPEG 2000 image"),
    (b"\xff\x0a", "a JPEG XL image"),
    (b"\x00\x00\x00\x0cJXL ", "a JPEG XL image"),
    (b"II+\x00", "a BigTIFF image"),
    (b"MM\x00+", "a BigTIFF image"),
    (b"8BPS", "a Photoshop document"),
    (b"\x00\x00\x01\x00", "an icon"),
    (b"v/1\x01", "an OpenEXR image"),
    (b"#?RADIANCE", "a Radiance HDR image"),
    (b"PK\x03\x04", "a zip archive"),
    (b"PK\x05\x06", "an empty zip archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"BZh", "a bzip2 archive"),
    (b"\xfd7zXZ\x00", "an xz archive"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive"),
    (b"Rar!\x1a\x07", "a RAR archive"),
    (b"(\xb5/\xfd", "a zstd archive"),
    (b"\x1aE\xdf\xa3", "a Matroska or WebM video"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
)

# Brands of ISO base media files.
_BRANDS = {
    b"hevc": "a sequence of HEIC images",
    b"hevx": "a sequence of HEIC images",
    b"mif1": "an HEIF image",
    b"msf1": "an HEIF image",
    b"avif": "an AVIF image",
    b"avis": "an AVIF image",
    b"crx ": "a Canon raw image",
    b"qt  ": "a QuickTime film",
}


def image_type(data: bytes) -> str:
    """The type of an image: ``jpeg``, ``png``, ``webp``, ``bmp``, ``tiff`` or ``heic``.

    Raises
    ------
    BadImage
        ``not-a-picture``; the text says what the file seems to be.
    """
    for magic, name in _IMAGES:
        if data.startswith(magic):
            return name
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return "webp"
    if is_heic(data):
        return "heic"
    raise BadImage(
        "not-a-picture",
        f"this seems to be {_guess(data)}; send an image as {', '.join(ACCEPTED[:-1])} or {ACCEPTED[-1]}",
    )


def _guess(data: bytes) -> str:
    """A name for a file that is not accepted, for the error's text."""
    if not data:
        return "an empty file"
    for magic, name in _OTHERS:
        if data.startswith(magic):
            return name
    if data[4:8] == b"ftyp":
        return _BRANDS.get(data[8:12], "an MP4 or similar film")
    if data.startswith(b"RIFF"):
        return "a RIFF file (sound or film)"
    if data[257:262] == b"ustar":
        return "a tar archive"
    return _guess_text(data[:1024])


def _guess_text(head: bytes) -> str:
    # The cut may split a multi-byte character, so an incomplete end may still be text.
    text = head.decode("utf-8", errors="ignore").lstrip("\ufeff \t\r\n")
    if b"\x00" in head or len(text.encode()) < len(head.strip()) - 3:
        return f"something unknown (it begins with {head[:4].hex(' ')})"
    lower = text.lower()
    if "<svg" in lower:
        return "an SVG drawing"
    if lower.startswith(("<!doctype html", "<html")):
        return "an HTML page"
    if lower.startswith("<?xml"):
        return "an XML document"
    if lower.startswith("data:image/"):
        return "a data: URL (send the image's bytes, not their base64)"
    if lower.startswith(("{", "[")):
        return "JSON"
    return "text"
