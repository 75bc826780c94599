"""The codec takes what is an image, upright and whole, and says of everything else what is wrong with it."""

import io
import struct
import time
import warnings
import zlib
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image as PilImage

from schemas.errors import BadImage, BodyTooLarge, RevisitError
from tests.sample_images import PNG_MAGIC, drawn, encoded, png_chunk
from worker.images.codec import Limits, decode, facts, probe, shrink, thumbnail

LIMITS = Limits(max_bytes=5_000_000, max_pixels=1_000_000)


def refusal(data: bytes, limits: Limits = LIMITS) -> RevisitError:
    """The error that both `decode` and, where it can see it, `probe` answer."""
    with pytest.raises(RevisitError) as caught:
        decode(data, limits)
    return caught.value


def apart(a: npt.NDArray[np.uint8], b: npt.NDArray[np.uint8]) -> float:
    return float(np.abs(a.astype(int) - b.astype(int)).mean())


@pytest.mark.parametrize("form", ["jpeg", "png", "webp", "bmp", "tiff"])
def test_every_accepted_format_decodes_to_what_was_drawn(form: str) -> None:
    pixels = drawn(80, 60)
    data = encoded(pixels, form)

    image = decode(data, LIMITS)

    assert (image.width, image.height, image.format, image.byte_count) == (80, 60, form, len(data))
    assert apart(image.pixels, pixels) < (4 if form in ("jpeg", "webp") else 0.001)
    assert probe(data, LIMITS) == facts(image)


@pytest.mark.parametrize("form", ["jpeg", "png", "webp", "tiff"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_honoured(form: str, orientation: int) -> None:
    upright = drawn(80, 60)
    # What a camera that was held that way stores: the inverse of what a viewer has to do.
    stored: Callable[[npt.NDArray[np.uint8]], npt.NDArray[np.uint8]] = {
        1: lambda p: p,
        2: lambda p: p[:, ::-1],
        3: lambda p: p[::-1, ::-1],
        4: lambda p: p[::-1],
        5: lambda p: p.transpose(1, 0, 2),
        6: lambda p: np.rot90(p, 1),
        7: lambda p: np.rot90(p, 2).transpose(1, 0, 2),
        8: lambda p: np.rot90(p, -1),
    }[orientation]
    exif = PilImage.Exif()
    exif[0x0112] = orientation
    data = encoded(np.ascontiguousarray(stored(upright)), form, exif=exif)

    image = decode(data, LIMITS)

    assert (image.width, image.height) == (80, 60)
    assert apart(image.pixels, upright) < 4
    assert probe(data, LIMITS) == facts(image)
    small = PilImage.open(io.BytesIO(thumbnail(data, 40)))
    assert small.size == (40, 30)
    assert apart(np.asarray(small), np.asarray(PilImage.fromarray(upright).resize((40, 30)))) < 8


@pytest.mark.filterwarnings("ignore:Corrupt EXIF data")
def test_a_nonsense_orientation_and_a_broken_exif_block_do_not_spoil_an_image() -> None:
    exif = PilImage.Exif()
    exif[0x0112] = 77
    for data in (
        encoded(drawn(80, 60), "jpeg", exif=exif),
        encoded(drawn(80, 60), "jpeg", exif=b"Exif\x00\x00II*\x00\xff\xff\xff\xff"),
    ):
        assert decode(data, LIMITS).width == 80
        assert thumbnail(data, 40)


def mode(name: str, pixels: npt.NDArray[np.uint8]) -> PilImage.Image:
    return PilImage.fromarray(pixels).convert(name)


def test_grey_becomes_three_equal_channels() -> None:
    for form in ("jpeg", "png", "tiff", "bmp"):
        out = io.BytesIO()
        mode("L", drawn(80, 60)).save(out, form)
        pixels = decode(out.getvalue(), LIMITS).pixels
        assert (pixels[..., 0] == pixels[..., 1]).all()
        assert (pixels[..., 1] == pixels[..., 2]).all()


@pytest.mark.parametrize("form", ["png", "webp", "tiff"])
def test_alpha_is_laid_over_white(form: str) -> None:
    rgba = np.zeros((40, 64, 4), np.uint8)
    rgba[:, 32:, 3] = 255  # black on the right; the left is transparent (black underneath)
    out = io.BytesIO()
    PilImage.fromarray(rgba).save(out, form, **({"lossless": True} if form == "webp" else {}))

    pixels = decode(out.getvalue(), LIMITS).pixels

    assert (pixels[:, :30] == 255).all()
    assert (pixels[:, 34:] == 0).all()


def test_a_palette_with_a_transparent_entry_is_laid_over_white() -> None:
    pil_image = PilImage.fromarray(np.repeat(np.arange(4, dtype=np.uint8), 16 * 40).reshape(64, 40))
    pil_image = pil_image.convert("P")
    pil_image.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 9, 9])
    out = io.BytesIO()
    pil_image.save(out, "PNG", transparency=0)

    pixels = decode(out.getvalue(), LIMITS).pixels

    assert pixels[0, 0].tolist() == [255, 255, 255]
    assert pixels[20, 0].tolist() == [0, 255, 0]


def test_sixteen_bits_keep_their_upper_eight() -> None:
    ramp = np.linspace(0, 65535, 64 * 48).reshape(48, 64).astype(np.uint16)
    for form in ("png", "tiff"):
        out = io.BytesIO()
        PilImage.fromarray(ramp).save(out, form)
        assert np.abs(decode(out.getvalue(), LIMITS).pixels[..., 0].astype(int) - (ramp >> 8)).max() <= 1
    wide = np.stack([ramp, ramp[::-1], ramp], axis=-1)
    assert np.abs(decode(png16(wide), LIMITS).pixels.astype(int) - (wide >> 8)).max() <= 1


def png16(pixels: npt.NDArray[np.uint16]) -> bytes:
    """A PNG with sixteen bits a channel, which Pillow cannot write."""
    height, width, _ = pixels.shape
    rows = b"".join(b"\x00" + row.astype(">u2").tobytes() for row in pixels)
    head = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    return PNG_MAGIC + png_chunk(b"IHDR", head) + png_chunk(b"IDAT", zlib.compress(rows)) + png_chunk(b"IEND", b"")


def test_a_cmyk_jpeg_keeps_its_colours() -> None:
    pixels = np.full((48, 64, 3), (200, 40, 40), np.uint8)
    out = io.BytesIO()
    mode("CMYK", pixels).save(out, "JPEG", quality=95)

    red, green, blue = decode(out.getvalue(), LIMITS).pixels[10, 10].tolist()

    assert red > 180
    assert green < 70
    assert blue < 70


def test_of_a_tiff_with_pages_the_first_counts() -> None:
    pages = [PilImage.fromarray(np.full((48, 64, 3), value, np.uint8)) for value in (10, 200)]
    out = io.BytesIO()
    pages[0].save(out, "TIFF", save_all=True, append_images=pages[1:])
    assert decode(out.getvalue(), LIMITS).pixels.mean() == 10


def test_float_pixels_are_refused_rather_than_guessed() -> None:
    out = io.BytesIO()
    PilImage.fromarray(np.ones((48, 64), np.float32)).save(out, "TIFF")
    assert refusal(out.getvalue()).code == "undecodable-picture"


@pytest.mark.parametrize("form", ["jpeg", "png", "webp", "bmp", "tiff"])
@pytest.mark.parametrize("share", [0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99])
def test_a_truncated_image_is_refused(form: str, share: float) -> None:
    data = encoded(drawn(320, 240), form)
    assert refusal(data[: int(len(data) * share)]).code == "undecodable-picture"


def test_a_flipped_byte_in_a_png_is_noticed() -> None:
    data = bytearray(encoded(drawn(120, 90), "png"))
    data[len(data) // 2] ^= 0xFF
    assert refusal(bytes(data)).code == "undecodable-picture"


def test_an_image_of_rubbish_behind_true_magic_bytes_is_undecodable() -> None:
    rubbish = np.random.default_rng(1).integers(0, 256, 4000, np.uint8).tobytes()
    riff = b"RIFF" + struct.pack("<I", 4000) + b"WEBPVP8 "
    for magic in (b"\xff\xd8\xff\xe0", PNG_MAGIC, b"BM", b"II*\x00", b"MM\x00*", riff):
        assert refusal(magic + rubbish).code == "undecodable-picture", magic


def test_what_cannot_be_read_is_said_in_words_of_the_file() -> None:
    """Not by the objects inside the service: ``<_io.BytesIO object at 0x7f...>``."""
    for data in (PNG_MAGIC, b"II*\x00" + bytes(90), b"BM" + bytes(90)):
        assert "object at" not in refusal(data).detail
    assert refusal(b"").detail.startswith("this seems to be an empty file; send an image as jpeg")


def iso(brand: bytes) -> bytes:
    return b"\x00\x00\x00\x18ftyp" + brand + b"\x00\x00\x00\x00mif1" + brand + b"\x00" * 400


def gif(frames: int) -> bytes:
    images = [PilImage.fromarray(drawn(64, 48)).quantize(8) for _ in range(frames)]
    out = io.BytesIO()
    images[0].save(out, "GIF", save_all=True, append_images=images[1:])
    return out.getvalue()


UNKNOWN_PLACES = {
    "a GIF": gif(1),
    "a GIF that moves": gif(3),
    "a PDF": b"%PDF-1.7\n" + b"0" * 200,
    "an SVG drawing": b'<?xml version="1.0"?>\n<svg xmlns="http://www.w3.org/2000/svg"/>',
    "a sequence of HEIC images": iso(b"hevc"),
    "an AVIF image": iso(b"avif"),
    "an MP4 or similar film": iso(b"isom"),
    "a JPEG 2000 image": b"\x00\x00\x00\x0cjP  \r\n\x87\n" + b"\x00" * 100,
    "a zip archive": b"PK\x03\x04" + b"\x00" * 100,
    "a gzip archive": b"\x1f\x8b\x08" + b"\x00" * 100,
    "a tar archive": b"a.jpg".ljust(257, b"\x00") + b"ustar\x0000" + b"\x00" * 300,
    "an HTML page": b"<!DOCTYPE html><p>502",
    "JSON": b'{"image": "aGVsbG8="}',
    "text": "Grüße vom Marktplatz".encode(),
    "a data: URL": b"data:image/png;base64,iVBORw0KGgo=",
    "something unknown": b"\x00\x01\x02\x03" * 50,
}


@pytest.mark.parametrize("name", UNKNOWN_PLACES)
def test_what_is_not_an_image_is_refused_by_its_content_and_named(name: str) -> None:
    error = refusal(UNKNOWN_PLACES[name])
    assert error.code == "not-a-picture"
    assert name.removesuffix(" that moves") in error.detail


def test_an_animated_webp_is_refused() -> None:
    frames = [PilImage.fromarray(drawn(64, 48, seed)) for seed in range(3)]
    out = io.BytesIO()
    frames[0].save(out, "WEBP", save_all=True, append_images=frames[1:])
    assert refusal(out.getvalue()).code == "not-a-picture"


def apng(frames: int, default_image: bool = False) -> bytes:
    images = [PilImage.fromarray(drawn(64, 48, seed)) for seed in range(frames + default_image)]
    out = io.BytesIO()
    images[0].save(out, "PNG", save_all=True, append_images=images[1:], default_image=default_image)
    return out.getvalue()


def test_an_animated_png_is_refused_as_an_animated_webp_is() -> None:
    for data in (apng(2), apng(3), apng(1, default_image=True), apng(2, default_image=True)):
        error = refusal(data)
        assert error.code == "not-a-picture"
        assert "animated PNG" in error.detail


def test_a_png_whose_single_frame_is_its_default_image_is_a_still_image() -> None:
    still = encoded(drawn(64, 48), "png")
    begin = still.index(b"IDAT") - 4
    control = png_chunk(b"acTL", struct.pack(">II", 1, 0))
    control += png_chunk(b"fcTL", struct.pack(">IIIIIHHBB", 0, 64, 48, 0, 0, 1, 10, 0, 0))
    one_frame = still[:begin] + control + still[begin:]
    assert np.array_equal(decode(one_frame, LIMITS).pixels, drawn(64, 48))


@pytest.mark.parametrize(("width", "height"), [(1, 1), (31, 32), (32, 31), (1000, 5)])
def test_an_image_smaller_than_32_by_32_is_refused(width: int, height: int) -> None:
    error = refusal(encoded(drawn(width, height), "png"))
    assert error.code == "picture-too-small"
    assert f"{width} x {height}" in error.detail


def test_32_by_32_is_enough() -> None:
    assert decode(encoded(drawn(32, 32), "png"), LIMITS).width == 32


def test_a_pixel_bomb_is_refused_from_its_header_at_once() -> None:
    head = struct.pack(">IIBBBBB", 50_000, 50_000, 8, 2, 0, 0, 0)
    bomb = PNG_MAGIC + png_chunk(b"IHDR", head) + png_chunk(b"IDAT", zlib.compress(bytes(1_000_000)))
    bomb += png_chunk(b"IEND", b"")
    begin = time.perf_counter()

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        error = refusal(bomb, Limits())

    assert error.code == "picture-too-large"
    assert "2500.0 megapixels; at most 50" in error.detail
    assert time.perf_counter() - begin < 3


@pytest.mark.parametrize("form", ["png", "jpeg", "webp"])
def test_a_header_is_read_without_decoding_a_pixel(form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    data = encoded(drawn(64, 48), form)

    def load(pil_image: object) -> None:
        pytest.fail("pixels were decoded")

    monkeypatch.setattr("PIL.ImageFile.ImageFile.load", load)
    monkeypatch.setattr("PIL.WebPImagePlugin.WebPImageFile.load", load)
    assert probe(data, LIMITS).width == 64


def test_orientation_behind_the_pixels_of_a_png_is_honoured() -> None:
    plain = encoded(drawn(80, 60), "png")
    exif = PilImage.Exif()
    exif[0x0112] = 6
    end = plain.index(b"IEND") - 4
    turned = plain[:end] + png_chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\x00\x00")) + plain[end:]
    assert (probe(turned, LIMITS).width, probe(turned, LIMITS).height) == (60, 80)
    assert np.array_equal(decode(turned, LIMITS).pixels, np.rot90(decode(plain, LIMITS).pixels, -1))


def test_a_jpeg_bomb_is_refused_from_its_header() -> None:
    data = bytearray(encoded(drawn(64, 48), "jpeg"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", 65_500, 65_500)
    assert refusal(bytes(data), Limits()).code == "picture-too-large"


def of_size(width: int, height: int) -> bytes:
    """A PNG whose header says so."""
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return PNG_MAGIC + head + png_chunk(b"IDAT", zlib.compress(bytes(1000))) + png_chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("width", "height", "told"),
    [
        (400_000, 124, "a side of at most 65,500"),
        (124, 400_000, "a side of at most 65,500"),
        (65_501, 20_000, "a side of at most 65,500"),
        (65_500, 760, "at most 50 times as long as the other"),
        (32, 1601, "cut it into several images"),
    ],
)
def test_a_thread_of_an_image_is_refused_from_its_header(width: int, height: int, told: str) -> None:
    error = refusal(of_size(width, height), Limits(max_pixels=2_000_000_000))

    assert error.code == "picture-too-large"
    assert f"{width} x {height} pixels" in error.detail
    assert told in error.detail


@pytest.mark.parametrize(("width", "height"), [(32, 1600), (1600, 32), (12_000, 800)])
def test_a_strip_is_taken(width: int, height: int) -> None:
    assert decode(encoded(drawn(width, height), "png"), Limits()).width == width


@pytest.mark.parametrize("form", ["png", "jpeg"])
def test_an_image_of_very_many_parts_is_refused_at_once(form: str) -> None:
    """Each part costs a step of Python in the decoder, and once more whenever the image is given back."""
    data = encoded(drawn(64, 48), form)
    parts = png_chunk(b"tEXt", b"a\x00b") * 49_000 if form == "png" else b"\xff\xfe\x00\x02" * 9_000
    after = 33 if form == "png" else 2
    assert decode(data[:after] + parts + data[after:], LIMITS).width == 64

    begin = time.perf_counter()
    error = refusal(data[:after] + parts * 30 + data[after:], Limits())

    assert error.code == "undecodable-picture"
    assert "it has more than" in error.detail
    assert time.perf_counter() - begin < 3


def test_more_bytes_than_allowed_are_refused() -> None:
    with pytest.raises(BodyTooLarge):
        decode(encoded(drawn(320, 240), "bmp"), Limits(max_bytes=1000))


def test_nothing_at_all_is_not_an_image() -> None:
    with pytest.raises(BadImage):
        decode(b"", LIMITS)


def test_an_image_that_is_kept_small_keeps_its_digest() -> None:
    image = decode(encoded(drawn(320, 240), "png"), LIMITS)
    small = shrink(image, 64)
    assert (small.width, small.height, small.digest) == (64, 48, image.digest)
    assert apart(small.pixels, np.asarray(PilImage.fromarray(image.pixels).resize((64, 48)))) < 3
    assert shrink(image, 320) is image


def test_a_thumbnail_is_never_enlarged_and_tells_no_position() -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825)[1] = "N"
    exif[0x010E] = "my garden"
    small = PilImage.open(io.BytesIO(thumbnail(encoded(drawn(80, 60), "jpeg", exif=exif, comment=b"mine"), 400)))
    assert small.size == (80, 60)
    assert not small.getexif()
    assert "comment" not in small.info
