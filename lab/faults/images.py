"""Mutated pictures through the decoders: ``python -m lab.faults.images --count 20000 --seed 1``.

Drawn pictures in every format and mode, damaged by flips, cuts, splices, swaps, extreme header fields, other files
behind them, and bombs. Allowed are an image within the limits and a refusal; whatever else happens is printed with the
number that makes the same bytes again. Picture number N of a seed is always the same, so ``--first N`` resumes.
"""

import argparse
import io
import json
import random
import re
import struct
import sys
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image as PilImage

from lab.faults.formats import arithmetic_jpegs, interlaced_png, run_length_bmp, tiled_tiff
from lab.faults.heics import heics
from schemas.errors import BadImage, BodyTooLarge
from worker.images import png
from worker.images.apart.pool import DecoderPool
from worker.images.codec import Limits
from worker.images.stripping import strip

LIMITS = Limits(max_bytes=5_000_000, max_pixels=4_000_000)
DEADLINE_S = 10.0
SLOW_S = 5.0
_EXTREMES = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_TIFF = ("raw", "tiff_lzw", "tiff_adobe_deflate", "packbits", "jpeg", "zstd", "lzma", "group3", "group4")


def _saved(image: PilImage.Image, form: str, **options: Any) -> bytes:
    out = io.BytesIO()
    image.save(out, form, **options)
    return out.getvalue()


@lru_cache
def sound() -> dict[str, bytes]:
    """A drawn picture in every format and mode, by name."""
    coarse = np.random.default_rng(1).integers(0, 256, (8, 10, 3), np.uint8)
    rgb = PilImage.fromarray(coarse).resize((96, 64), PilImage.Resampling.BICUBIC)
    grey16 = PilImage.fromarray(np.asarray(rgb)[..., 0].astype(np.uint16) * 257)
    made = {
        "jpeg": _saved(rgb, "JPEG"),
        "jpeg-progressive": _saved(rgb, "JPEG", progressive=True),
        "jpeg-restarts": _saved(rgb, "JPEG", restart_marker_rows=1),
        "jpeg-exif": _saved(rgb, "JPEG", exif=b"Exif\x00\x00MM\x00*" + bytes(30), comment=b"hello"),
        "bmp": _saved(rgb, "BMP"),
        "webp": _saved(rgb, "WEBP"),
        "webp-lossless": _saved(rgb, "WEBP", lossless=True),
        "webp-alpha": _saved(rgb.convert("RGBA"), "WEBP"),
        "png-16": _saved(grey16, "PNG"),
        "tiff-16": _saved(grey16, "TIFF"),
        "bmp-rle": run_length_bmp(),
        **{f"heic-{name}": data for name, data in heics().items()},
    }
    for mode in ("L", "CMYK"):
        made[f"jpeg-{mode}"] = _saved(rgb.convert(mode), "JPEG")
    for mode in ("RGB", "RGBA", "L", "LA", "P", "1"):
        made[f"png-{mode}"] = _saved(rgb.convert(mode), "PNG")
    for mode in ("L", "P", "1"):
        made[f"bmp-{mode}"] = _saved(rgb.convert(mode), "BMP")
    for compression in _TIFF:
        plain = rgb.convert("1") if compression.startswith("group") else rgb
        made[f"tiff-{compression}"] = _saved(plain, "TIFF", compression=compression)
    for mode in ("RGBA", "CMYK", "P", "LAB"):
        image = rgb.convert(mode) if mode != "LAB" else PilImage.fromarray(np.asarray(rgb), "RGB")
        made[f"tiff-{mode}"] = _saved(image, "TIFF")
    for mode, channels in (("L", 1), ("LA", 2), ("RGB", 3), ("RGBA", 4)):
        made[f"png-interlaced-{mode}"] = interlaced_png(np.asarray(rgb.convert(mode)).reshape(64, 96, channels))
    for compression in ("raw", "deflate"):
        made[f"tiff-tiles-{compression}"] = tiled_tiff(np.asarray(rgb), compression)
    made["tiff-tiles-planar"] = tiled_tiff(np.asarray(rgb), planar=True)
    made["tiff-tiles-jpeg"] = tiled_tiff(np.asarray(rgb.convert("L"))[..., None], "jpeg")
    return made | {f"jpeg-arithmetic-{kind}": data for kind, data in arithmetic_jpegs().items()}


@lru_cache
def bombs() -> dict[str, bytes]:
    """Small files that ask for much: pixels, scans, text, strips, directories without end."""
    files = sound()
    side = 1999
    wide = struct.pack(">IIBBBBB", side, side, 8, 6, 0, 0, 0)
    packed = zlib.compress(bytes((1 + 4 * side) * side), 9)
    huge = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 6, 0, 0, 0)
    text = b"Comment\x00\x00" + zlib.compress(bytes(200_000_000), 9)
    profile = b"icc\x00\x00" + zlib.compress(bytes(200_000_000), 9)
    scans = files["jpeg-progressive"]
    last = scans.rindex(b"\xff\xda")
    tiff = files["tiff-raw"]
    loop = bytearray(tiff)
    (at,) = struct.unpack_from("<I", tiff, 4)
    (count,) = struct.unpack_from("<H", tiff, at)
    struct.pack_into("<I", loop, at + 2 + 12 * count, at)
    large = bytearray(scans)
    frame = scans.index(b"\xff\xc2") + 5
    large[frame : frame + 4] = struct.pack(">HH", 1990, 1990)

    def of(*parts: tuple[bytes, bytes]) -> bytes:
        return png.SIGNATURE + b"".join(png.chunk(kind, content) for kind, content in (*parts, (b"IEND", b"")))

    return {
        "png-pixels": of((b"IHDR", wide), (b"IDAT", packed)),
        "png-huge": of((b"IHDR", huge), (b"IDAT", packed)),
        "png-too-much-data": of((b"IHDR", files["png-RGB"][16:29]), (b"IDAT", zlib.compress(bytes(300_000_000), 9))),
        "png-text": of((b"IHDR", wide), (b"zTXt", text), (b"IDAT", packed)),
        "png-profile": of((b"IHDR", wide), (b"iCCP", profile), (b"IDAT", packed)),
        "jpeg-scans": scans[:-2] + scans[last:-2] * 5000 + scans[-2:],
        "jpeg-99-large-scans": bytes(large)[:-2] + bytes(large)[last:-2] * 88 + scans[-2:],
        "tiff-loop": bytes(loop),
        "webp-largest": b"RIFF"
        + struct.pack("<I", 30)
        + b"WEBPVP8X\x0a\x00\x00\x00"
        + bytes(4)
        + b"\xff" * 6
        + bytes(8),
        "webp-alpha-largest": b"RIFF\x16\x00\x00\x00WEBPVP8L\x0a\x00\x00\x00/" + b"\xff\xff\xff\x1f" + bytes(5),
    }


def mutated(seed: int, number: int) -> tuple[str, bytes]:
    """Picture `number` of a seed: its name and bytes."""
    chance = random.Random(f"{seed}/{number}")
    if number % 100 == 99:
        name = chance.choice(sorted(bombs()))
        return f"bomb {name}", bombs()[name]
    name = chance.choice(sorted(sound()))
    data = bytearray(sound()[name])
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        how = chance.choice(sorted(_MUTATIONS))
        name += f" {how}"
        data = _MUTATIONS[how](data, chance) or data
    return name, bytes(data)


def _flip(data: bytearray, chance: random.Random) -> bytearray:
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return data


def _head(data: bytearray, chance: random.Random) -> bytearray:
    """An extreme value over a field near the beginning or the end, where directories lie."""
    size, order = chance.choice((1, 2, 4)), chance.choice(("<", ">"))
    value = chance.choice(_EXTREMES) & (256**size - 1)
    at = chance.randrange(min(len(data), 200))
    at = at if chance.random() < 0.7 else max(0, len(data) - 200) + at
    packed = struct.pack(order + {1: "B", 2: "H", 4: "I"}[size], value)
    data[at : at + size] = packed
    return data


def _cut(data: bytearray, chance: random.Random) -> bytearray:
    return data[: chance.randrange(1, len(data) + 1)]


def _splice(data: bytearray, chance: random.Random) -> bytearray:
    other = sound()[chance.choice(sorted(sound()))]
    at, begin = chance.randrange(len(data)), chance.randrange(len(other))
    return data[:at] + other[begin : begin + chance.randrange(1, 500)] + data[at + chance.choice((0, 100)) :]


def _swap(data: bytearray, chance: random.Random) -> bytearray:
    """Two stretches change places, or one comes again."""
    length = chance.randrange(1, max(2, min(300, len(data) // 3)))
    one, two = (chance.randrange(max(1, len(data) - length)) for _ in range(2))
    data[one : one + length], data[two : two + length] = data[two : two + length], data[one : one + length]
    return data


def _behind(data: bytearray, chance: random.Random) -> bytearray:
    return data + chance.choice((b"PK\x03\x04" + bytes(90), b"<html><script>", sound()["jpeg"], bytes(1000)))


def _fix(data: bytearray, chance: random.Random) -> bytearray:
    """Right checksums of a PNG, so that damage gets past them."""
    if not data.startswith(png.SIGNATURE):
        return _flip(data, chance)
    parts = b"".join(png.chunk(kind, content) for kind, content in png.chunks(bytes(_flip(data, chance))))
    return bytearray(png.SIGNATURE + parts)


_MUTATIONS = {
    "flip": _flip,
    "head": _head,
    "cut": _cut,
    "splice": _splice,
    "swap": _swap,
    "behind": _behind,
    "fix": _fix,
}


@dataclass
class Report:
    """What became of the pictures.

    Parameters
    ----------
    outcomes : Counter
        ``image`` and the codes of refusals.
    ended : list of str
        Pictures that ended or hung their decoder and were refused for it.
    faults : list of str
        Pictures after which something else happened than is allowed.
    slowest_s : float
    peak_mb : float
        Most memory that a decoder's process held at once, in 10^6 bytes, with what it shares with the service. Of one
        that ended there is what it held after the picture before.
    peak_of : str
        The picture that took it there.
    """

    outcomes: Counter[str] = field(default_factory=Counter)
    ended: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    slowest_s: float = 0.0
    peak_mb: float = 0.0
    peak_of: str = ""


def study(pool: DecoderPool, seed: int, numbers: range) -> Iterator[Report]:
    """Put pictures through the decoders; the same report after each."""
    report = Report()
    for number in numbers:
        name, data = mutated(seed, number)
        began = time.monotonic()
        try:
            image = pool.decode(data)
            report.outcomes["image"] += 1
            if image.width * image.height > LIMITS.max_pixels:
                report.faults.append(f"{number} {name}: larger than the limit")
            _check_served(pool, data, image.pixels, image.format)
        except (BadImage, BodyTooLarge) as error:
            report.outcomes[error.code] += 1
            if "twice" in error.detail or "within" in error.detail:
                report.ended.append(f"{number} {name}: {error.detail}")
        except Exception as error:
            report.faults.append(f"{number} {name}: {type(error).__name__}: {error}")
        took = time.monotonic() - began
        report.slowest_s = max(report.slowest_s, took)
        if took > SLOW_S:
            report.faults.append(f"{number} {name}: took {took:.1f} s")
        peak = max((peak_memory_mb(process.pid) for process in pool.processes), default=0.0)
        if peak > report.peak_mb:
            report.peak_mb, report.peak_of = peak, f"{number} {name}"
        yield report


def peak_memory_mb(pid: int | None) -> float:
    """The most memory that a process has held, in 10^6 bytes; 0 when it does not run, or the system does not tell."""
    try:
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return 0.0
    found = re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE)
    return int(found[1]) * 1024 / 1e6 if found else 0.0


def _check_served(pool: DecoderPool, data: bytes, pixels: npt.NDArray[np.uint8], form: str) -> None:
    """Whether an accepted picture has a thumbnail, and the same pixels without its metadata; raises otherwise.

    The service compares the pixels of each rewritten TIFF and BMP itself, and serves a PNG where they differ.
    """
    try:
        pool.thumbnail(data, 64)
        stripped = _stripped(data, form)
        rewritten = stripped != data and form not in ("tiff", "bmp")
        if rewritten and not np.array_equal(pool.decode(stripped).pixels, pixels):
            raise AssertionError("without metadata it has other pixels")
    except BadImage as error:
        raise AssertionError(f"accepted, and then refused: {error.detail}") from error


def _stripped(data: bytes, form: str) -> bytes:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return strip(data, form)
        except ValueError:
            return data  # it is served as PNG


def main(arguments: list[str] | None = None) -> int:
    """The command; 1 when something happened that is not allowed."""
    parser = argparse.ArgumentParser(prog="python -m lab.faults.images", description=__doc__)
    parser.add_argument("--count", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first picture, to resume")
    parser.add_argument("--output", type=Path, help="write the report there as JSON")
    options = parser.parse_args(arguments)
    pool = DecoderPool(2, LIMITS, DEADLINE_S)
    report, began = Report(), time.monotonic()
    try:
        numbers = range(options.first, options.count)
        for number, report in zip(numbers, study(pool, options.seed, numbers), strict=True):
            if number % 1000 == 999:
                outcomes = dict(report.outcomes)
                print(f"{number + 1} {outcomes} ended {len(report.ended)} faults {len(report.faults)}", flush=True)
    finally:
        pool.close()
    told = {
        "count": options.count - options.first,
        "seed": options.seed,
        "seconds": round(time.monotonic() - began),
        "outcomes": dict(report.outcomes),
        "ended": report.ended,
        "faults": report.faults,
        "slowest_s": round(report.slowest_s, 2),
        "peak_mb": round(report.peak_mb),
        "peak_of": report.peak_of,
    }
    text = json.dumps(told, indent=1)
    print(text)
    if options.output is not None:
        options.output.write_text(text)
    return 1 if report.faults else 0


if __name__ == "__main__":
    sys.exit(main())
