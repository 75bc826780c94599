"""Images of cameras with 10, 12 or 14 bits, whose files have room for 16."""

import io
import struct
import zlib

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image as PilImage

from tests.sample_images import PNG_MAGIC, drawn, png_chunk
from worker.images.codec import Limits, decode, thumbnail
from worker.images.quality import problem
from worker.images.stripping import strip

LIMITS = Limits()
Samples = npt.NDArray[np.uint16]


def taken(bits: int, colours: bool = False, light: float = 1.0) -> Samples:
    """A drawing by a sensor of so many bits, the lowest of which are not all alike."""
    of_eight = drawn(64, 48, 3).astype(float) * light
    fine = np.random.default_rng(5).random(of_eight.shape)
    made = np.minimum((of_eight + fine) * 2 ** (bits - 8), 2**bits - 1).astype(np.uint16)
    return np.ascontiguousarray(made if colours else made[..., 1])


def png_of(samples: Samples, said: int | None = None) -> bytes:
    bgr = samples[..., [2, 1, 0, *range(3, samples.shape[2])]] if samples.ndim == 3 else samples
    whole = bytes(cv2.imencode(".png", bgr)[1])
    if said is None:
        return whole
    chunk = png_chunk(b"sBIT", bytes([said] * (3 if samples.ndim == 3 else 1)))
    return whole[:33] + chunk + whole[33:]  # behind IHDR


def grey_with_alpha(samples: Samples) -> bytes:
    """A PNG of grey and alpha, which OpenCV does not write."""
    height, width = samples.shape[:2]
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in samples)
    head = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 4, 0, 0, 0))
    return PNG_MAGIC + head + png_chunk(b"IDAT", zlib.compress(rows)) + png_chunk(b"IEND", b"")


def tiff_of(samples: Samples, order: str = "<", bits: int = 16, **said: int) -> bytes:
    """A TIFF without compression; grey of 12 bits is packed."""
    height, width = samples.shape[:2]
    channels = samples.shape[2] if samples.ndim == 3 else 1
    if bits == 12:
        pairs = samples.reshape(height, -1, 2).astype(np.uint32)
        joined = pairs[..., 0] << 12 | pairs[..., 1]
        pixels = np.stack([joined >> shift & 255 for shift in (16, 8, 0)], axis=-1).astype(np.uint8).tobytes()
    else:
        pixels = samples.astype(order + "u2").tobytes()
    at = 8 + len(pixels)
    fields = {256: width, 257: height, 259: 1, 262: 2 if channels == 3 else said.get("photometric", 1), 273: 8,
              277: channels, 278: height, 279: len(pixels)}  # fmt: skip
    fields |= {tag: said[name] for name, tag in (("most", 281), ("turned", 274)) if name in said}
    entries, tail = [], b""
    for tag in sorted([*fields, 258]):
        if tag == 258 and channels == 3:
            tail = struct.pack(order + "3H", bits, bits, bits)
            entries.append(struct.pack(order + "HHII", 258, 3, 3, at + 6 + 12 * (len(fields) + 1)))
        else:
            value = fields.get(tag, bits)
            short = tag not in (273, 279)
            entries.append(struct.pack(order + ("HHIHxx" if short else "HHII"), tag, 3 if short else 4, 1, value))
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, at)
    return head + pixels + struct.pack(order + "H", len(entries)) + b"".join(entries) + bytes(4) + tail


def planes_of(samples: Samples, order: str = "<", zipped: bool = False) -> bytes:
    """A TIFF whose colours lie one behind the other, plain or each of them packed by zlib."""
    height, width, channels = samples.shape
    planes = [samples[..., channel].astype(order + "u2").tobytes() for channel in range(channels)]
    planes = [zlib.compress(plane) for plane in planes] if zipped else planes
    begins = [8 + sum(map(len, planes[:number])) for number in range(channels)]
    at, fields = 8 + sum(map(len, planes)), 11
    tail = at + 6 + 12 * fields
    short, long = "HHIHxx", "HHII"
    entries = [(short, 256, width), (short, 257, height), (long, 258, tail), (short, 259, 8 if zipped else 1),
               (short, 262, 2), (long, 273, tail + 2 * channels), (short, 277, channels), (short, 278, height),
               (long, 279, tail + 6 * channels), (short, 284, 2), (short, 338, 2)]  # fmt: skip
    del entries[channels + 7 :]  # without alpha, what it means
    packed = struct.pack(order + "H", len(entries))
    for form, tag, value in entries:
        many = channels if tag in (258, 273, 279) else 1
        packed += struct.pack(order + form, tag, 4 if tag in (273, 279) else 3, many, value)
    packed = (packed + bytes(4)).ljust(tail - at, b"\0")
    packed += struct.pack(f"{order}{channels}H", *[16] * channels)
    packed += struct.pack(f"{order}{channels}I", *begins)
    packed += struct.pack(f"{order}{channels}I", *map(len, planes))
    return (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, at) + b"".join(planes) + packed


def shown(data: bytes) -> npt.NDArray[np.uint8]:
    return decode(data, LIMITS).pixels


@pytest.mark.parametrize("colours", [False, True])
@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_what_a_sensor_of_fewer_bits_wrote_is_as_light_as_it_was(bits: int, colours: bool) -> None:
    samples = taken(bits, colours)
    right = np.broadcast_to((samples if colours else samples[..., None]) >> bits - 8, (48, 64, 3))
    for data in (png_of(samples), tiff_of(samples), tiff_of(samples, ">")):
        assert np.abs(shown(data).astype(int) - right).max() <= 1
        assert problem(shown(data)) is None or "blurred" in str(problem(shown(data)))
        small = np.asarray(PilImage.open(io.BytesIO(thumbnail(data, 64))).convert("RGB"))
        assert abs(float(small.mean()) - float(right.mean())) < 3


def test_a_compressed_tiff_in_colour_is_read_like_a_plain_one() -> None:
    samples = taken(12, colours=True)
    data = cv2.imencode(".tiff", samples[..., ::-1])[1].tobytes()
    assert np.array_equal(shown(data), samples >> 4)


@pytest.mark.parametrize("bits", [12, 16])
def test_what_lies_beside_the_colours_makes_them_no_darker(bits: int) -> None:
    samples = taken(bits, colours=True)
    right, light = samples >> bits - 8, samples[..., 1:2]
    alpha = np.full((48, 64, 1), 65535, np.uint16)
    alpha[:, :32] = 0  # which shows white
    clear = np.broadcast_to(alpha == 0, right.shape)
    joined = np.concatenate([samples, alpha], axis=-1)
    for data in (png_of(joined), planes_of(joined), cv2.imencode(".tiff", joined[..., [2, 1, 0, 3]])[1]):
        assert np.abs(shown(bytes(data)).astype(int) - np.where(clear, 255, right)).max() <= 1
    grey = np.concatenate([light, alpha], axis=-1)
    assert np.abs(shown(grey_with_alpha(grey)).astype(int) - np.where(clear, 255, light >> bits - 8)).max() <= 1
    named = png_of(samples)
    named = named[:33] + png_chunk(b"tRNS", bytes(6)) + named[33:]  # a colour that is not in it
    assert np.abs(shown(named).astype(int) - right).max() <= 1


def test_a_tiff_of_twelve_packed_bits_says_so() -> None:
    """However dim it is."""
    for light in (1.0, 0.2):
        samples = taken(12, light=light)
        assert np.array_equal(shown(tiff_of(samples, bits=12))[..., 0], samples >> 4)


def test_what_the_file_says_of_its_range_counts() -> None:
    dim = taken(12, light=0.2)
    assert dim.max() < 1024  # as few as ten bits would hold
    assert np.array_equal(shown(tiff_of(dim, most=4095))[..., 0], dim >> 4)
    assert np.array_equal(shown(png_of(dim, said=12))[..., 0], dim >> 4)
    assert shown(tiff_of(dim, most=65535)).max() == dim.max() >> 8
    assert shown(png_of(dim, said=16)).max() == dim.max() >> 8
    assert np.array_equal(shown(tiff_of(dim, most=100))[..., 0], dim >> 2)  # which cannot be


def test_a_range_that_a_file_says_stays_when_its_metadata_go() -> None:
    dim = taken(12, light=0.2)
    for data, form in ((tiff_of(dim, most=4095) + bytes(99), "tiff"), (png_of(dim, said=12) + bytes(99), "png")):
        assert (bare := strip(data, form)) != data
        assert np.array_equal(shown(bare), shown(data))


@pytest.mark.parametrize("said", [None, 12])
def test_a_dim_image_that_was_scaled_to_sixteen_bits_stays_dim(said: int | None) -> None:
    """The samples are below 4096 by the light, not by the sensor."""
    eight = (drawn(64, 48, 3)[..., 1] // 20).astype(np.uint16)
    twelve = taken(12, light=0.05)
    for samples in (eight << 8, eight * 257, twelve << 4, twelve << 4 | twelve >> 8, (twelve * (65535 / 4095)).round()):
        assert samples.max() < 4096
        samples = samples.astype(np.uint16)
        assert np.abs(shown(png_of(samples, said))[..., 0].astype(int) - (samples >> 8)).max() <= 1


def test_of_a_grey_tiff_whose_zero_is_white_the_light_is_light() -> None:
    for bits in (12, 16):
        samples = taken(bits)
        assert np.array_equal(shown(tiff_of(samples, photometric=0))[..., 0], 255 - (samples >> bits - 8))


def test_an_image_of_a_turned_camera_is_upright_whatever_its_bits() -> None:
    samples = taken(12, colours=True)
    assert np.array_equal(shown(tiff_of(samples, turned=6)), np.rot90(samples >> 4, -1))


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("bits", [10, 12, 16])
def test_colours_that_lie_apart_are_as_light_where_they_are_packed(order: str, bits: int) -> None:
    samples = taken(bits, colours=True)
    assert np.array_equal(shown(planes_of(samples, order, zipped=True)), samples >> bits - 8)
    opaque = np.concatenate([samples, np.full((48, 64, 1), 65535, np.uint16)], axis=-1)
    assert np.abs(shown(planes_of(opaque, order, zipped=True)).astype(int) - (samples >> bits - 8)).max() <= 1


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("bits", [12, 16])
def test_of_a_tiff_whose_colours_lie_apart_sixteen_bits_are_one_sample(order: str, bits: int) -> None:
    samples = taken(bits, colours=True)
    assert np.array_equal(shown(planes_of(samples, order)), samples >> bits - 8)
    opaque = np.concatenate([samples, np.full((48, 64, 1), 65535, np.uint16)], axis=-1)
    assert np.abs(shown(planes_of(opaque, order)).astype(int) - (samples >> bits - 8)).max() <= 1
    small = np.asarray(PilImage.open(io.BytesIO(thumbnail(planes_of(samples, order), 64))))
    assert abs(float(small.mean()) - float((samples >> bits - 8).mean())) < 3
