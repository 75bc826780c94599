"""What is served back has the enrolled pixels and nothing of its metadata."""

import io
import struct
from typing import Any

import numpy as np
import pytest
from PIL import Image as PilImage
from PIL.PngImagePlugin import PngInfo

from tests.sample_images import drawn, encoded, png_chunk
from worker.images.codec import Limits, decode
from worker.images.stripping import strip

LIMITS = Limits()
SECRET = b"48.1374N of my garden"
FORMS = ("jpeg", "png", "webp", "bmp", "tiff")
COMPRESSIONS = ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits", "tiff_deflate", "jpeg", "zstd", "lzma")


def exif(orientation: int = 1) -> PilImage.Exif:
    made = PilImage.Exif()
    made[0x0112] = orientation
    made[0x010E] = SECRET.decode()
    made[0x010F] = SECRET.decode()
    return made


def with_secrets(form: str, orientation: int = 1, **options: Any) -> bytes:
    """An image with the secret in every place that Pillow writes to, and behind its end."""
    pixels = drawn(96, 64)
    if form == "jpeg":
        options |= {"comment": SECRET, "xmp": SECRET}
    if form == "png":
        info = PngInfo()
        info.add_text("Comment", SECRET.decode())
        info.add_itxt("XML:com.adobe.xmp", SECRET.decode())
        options |= {"pnginfo": info}
    if form == "webp":
        options |= {"xmp": SECRET, "lossless": True}
    if form in ("jpeg", "png", "webp", "tiff"):
        options |= {"exif": exif(orientation)}
    return encoded(pixels, form, **options) + b"PK\x03\x04<html>" + SECRET


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_pixels_and_orientation_stay_and_secrets_go(form: str, orientation: int) -> None:
    data = with_secrets(form, orientation)
    stripped = strip(data, form)
    assert SECRET in data
    assert SECRET not in stripped
    assert b"PK\x03\x04" not in stripped
    assert np.array_equal(decode(stripped, LIMITS).pixels, decode(data, LIMITS).pixels)
    assert strip(stripped, form) == stripped


@pytest.mark.parametrize("form", FORMS)
def test_an_image_without_metadata_comes_back_byte_for_byte(form: str) -> None:
    data = encoded(drawn(96, 64), form)
    assert strip(data, form) == data


@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("mode", ["RGB", "L", "RGBA", "CMYK", "1", "P", "I;16"])
def test_a_tiff_of_every_compression_keeps_its_pixels(compression: str, mode: str) -> None:
    if compression == "jpeg" and mode in ("1", "P", "I;16"):
        compression = "packbits"
    image = PilImage.fromarray(drawn(96, 64))
    image = PilImage.fromarray(np.asarray(image)[..., 0].astype(np.uint16)) if mode == "I;16" else image.convert(mode)
    out = io.BytesIO()
    image.save(out, "TIFF", compression=compression, description=SECRET.decode())
    stripped = strip(out.getvalue(), "tiff")
    assert SECRET not in stripped
    assert np.array_equal(decode(stripped, LIMITS).pixels, decode(out.getvalue(), LIMITS).pixels)


def test_other_pages_of_a_tiff_are_not_given_away() -> None:
    pages = [PilImage.fromarray(drawn(64, 48, seed)) for seed in range(2)]
    out = io.BytesIO()
    pages[0].save(out, "TIFF", save_all=True, append_images=pages[1:])
    stripped = strip(out.getvalue(), "tiff")
    assert getattr(PilImage.open(io.BytesIO(stripped)), "n_frames", 1) == 1
    assert np.array_equal(decode(stripped, LIMITS).pixels, drawn(64, 48, 0))


@pytest.mark.parametrize("form", ["jpeg", "png", "webp"])
def test_a_colour_profile_stays(form: str) -> None:
    from PIL import ImageCms

    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    data = with_secrets(form, icc_profile=profile)
    assert PilImage.open(io.BytesIO(strip(data, form))).info["icc_profile"] == profile


def test_the_thumbnail_within_a_jfif_header_goes() -> None:
    data = encoded(drawn(96, 64), "jpeg")
    head = b"JFIF\x00\x01\x01\x00\x00\x01\x00\x01\x02\x02" + b"thumbthumbth"
    given = data[:2] + b"\xff\xe0" + struct.pack(">H", len(head) + 2) + head + data[20:]
    stripped = strip(given, "jpeg")
    assert b"thumb" not in stripped
    assert np.array_equal(decode(stripped, LIMITS).pixels, decode(data, LIMITS).pixels)


def test_what_hides_between_the_segments_of_a_jpeg_goes() -> None:
    data = encoded(drawn(96, 64), "jpeg")
    at = data.index(b"\xff\xdb")
    given = data[:at] + SECRET + data[at:]
    assert SECRET not in strip(given, "jpeg")


def test_an_unknown_chunk_of_a_png_goes() -> None:
    data = encoded(drawn(96, 64), "png")
    given = data[:33] + png_chunk(b"prVt", SECRET) + data[33:]
    assert strip(given, "png") == data


def webp_of(flags: int, *chunks: tuple[bytes, bytes]) -> bytes:
    """A WebP of 96 x 64 pixels in the extended format (RFC 9649, 2.7), with these chunks."""
    parts = [
        kind + struct.pack("<I", len(content)) + content + bytes(len(content) % 2)
        for kind, content in ((b"VP8X", bytes((flags, 0, 0, 0, 95, 0, 0, 63, 0, 0))), *chunks)
    ]
    return b"RIFF" + struct.pack("<I", 4 + sum(map(len, parts))) + b"WEBP" + b"".join(parts)


def test_the_one_frame_of_an_animation_is_not_taken_for_metadata() -> None:
    pixels = encoded(drawn(96, 64), "webp", lossless=True)[12:]
    frame = bytes((0, 0, 0, 0, 0, 0, 95, 0, 0, 63, 0, 0, 100, 0, 0, 0)) + pixels
    data = webp_of(2, (b"ANIM", bytes(6)), (b"ANMF", frame))

    assert np.array_equal(decode(data, LIMITS).pixels, drawn(96, 64))
    with pytest.raises(ValueError, match="one frame"):  # it is given back as PNG
        strip(data, "webp")


@pytest.mark.parametrize("form", FORMS)
def test_what_is_cut_is_stripped_or_refused(form: str) -> None:
    data = with_secrets(form)
    for cut in range(len(data)):
        try:
            strip(data[:cut], form)
        except (ValueError, OSError):
            continue


def test_what_a_tiff_had_before_a_program_took_it_out_is_not_given_away() -> None:
    """libtiff and GDAL write another directory behind the image, and leave the old one where it was."""
    out = io.BytesIO()
    PilImage.fromarray(drawn(96, 64, 3)).save(out, "TIFF", description="the garden of anna")
    data = out.getvalue() + bytes(len(out.getvalue()) % 2)
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    fields = [data[start : start + 12] for start in range(at + 2, at + 2 + 12 * count, 12)]
    kept = [field for field in fields if field[:2] != struct.pack("<H", 270)]  # ImageDescription
    edited = (
        data[:4] + struct.pack("<I", len(data)) + data[8:] + struct.pack("<H", len(kept)) + b"".join(kept) + bytes(4)
    )
    assert b"anna" in edited

    stripped = strip(edited, "tiff")

    assert b"anna" not in stripped
    assert np.array_equal(decode(stripped, LIMITS).pixels, decode(edited, LIMITS).pixels)
    assert strip(stripped, "tiff") == stripped


def tiff_of_strips(rows: int, size: int) -> bytes:
    """A TIFF with a strip for each row, of which each says that it has `size` bytes, and a secret."""
    pixels = drawn(32, rows).tobytes()
    begins = struct.pack(f"<{rows}I", *range(8, 8 + len(pixels), 96))
    sizes, depths = struct.pack(f"<{rows}I", *[size] * rows), struct.pack("<4H", 8, 8, 8, 0)
    at = 8 + len(pixels)
    where = at, at + len(begins), at + len(begins) + len(sizes)
    fields = [(256, 3, 1, 32), (257, 3, 1, rows), (258, 3, 3, where[2]), (259, 3, 1, 1), (262, 3, 1, 2)]
    fields += [(273, 4, rows, where[0]), (277, 3, 1, 3), (278, 3, 1, 1), (279, 4, rows, where[1])]
    fields += [(305, 2, 4, 0x61616100)]
    directory = struct.pack("<H", len(fields)) + b"".join(struct.pack("<HHII", *field) for field in fields) + bytes(4)
    head = b"II*\x00" + struct.pack("<I", where[2] + len(depths))
    return b"".join((head, pixels, begins, sizes, depths, directory, bytes(max(0, size - 96))))


def test_strips_of_a_tiff_that_lie_over_one_another_are_not_written_out() -> None:
    sound, crafted = tiff_of_strips(200, 96), tiff_of_strips(200, 1_000_000)  # 200 MB, if they were

    for data in (sound, crafted):
        assert np.array_equal(decode(data, LIMITS).pixels, drawn(32, 200))

    assert len(strip(sound, "tiff")) <= len(sound)
    with pytest.raises(ValueError, match="over one another"):
        strip(crafted, "tiff")


def test_a_webp_of_very_many_chunks_is_not_followed_to_its_end() -> None:
    pixels = encoded(drawn(96, 64), "webp", lossless=True)[20:]
    data = webp_of(0, (b"VP8L", pixels), *[(b"none", b"")] * 20_000)

    assert np.array_equal(decode(data, LIMITS).pixels, drawn(96, 64))
    with pytest.raises(ValueError, match="more than 10,000 chunks"):
        strip(data, "webp")


def test_a_tiff_of_more_strips_than_an_image_can_have_is_not_followed_to_its_end() -> None:
    strips, at = 300_000, 8 + 32 * 32
    begins, sizes = struct.pack(f"<{strips}I", *[8] * strips), struct.pack(f"<{strips}I", 1024, *[0] * (strips - 1))
    fields = [(256, 3, 1, 32), (257, 3, 1, 32), (258, 3, 1, 8), (259, 3, 1, 1), (262, 3, 1, 1), (273, 4, strips, at)]
    fields += [(277, 3, 1, 1), (278, 3, 1, 32), (279, 4, strips, at + len(begins)), (305, 2, 4, 0x61616100)]
    directory = struct.pack("<H", len(fields)) + b"".join(struct.pack("<HHII", *field) for field in fields) + bytes(4)
    head = b"II*\x00" + struct.pack("<I", at + len(begins) + len(sizes))
    data = b"".join((head, bytes(range(256)) * 4, begins, sizes, directory))

    assert decode(data, LIMITS).pixels.shape == (32, 32, 3)
    with pytest.raises(ValueError, match="more than 200,000 strips"):
        strip(data, "tiff")
