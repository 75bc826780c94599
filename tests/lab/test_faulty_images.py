"""Three hundred mutated pictures and every bomb: an image or a refusal, in time, and the decoders live."""

import struct

import numpy as np
import pytest

from lab.faults.formats import arithmetic_jpegs, interlaced_png, tiled_tiff
from lab.faults.images import DEADLINE_S, LIMITS, bombs, mutated, peak_memory_mb, sound, study
from schemas.errors import BadImage
from worker.images.apart.pool import DecoderPool
from worker.images.codec import decode
from worker.images.jpeg import Structure

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:PIL")


def test_sound_images_of_every_mode_are_taken_or_refused_for_a_reason() -> None:
    refused = set()
    for name, data in sound().items():
        try:
            decode(data, LIMITS)
        except BadImage:
            refused.add(name)
    assert refused == set()


def test_three_hundred_mutated_images_and_every_bomb() -> None:
    pool = DecoderPool(2, LIMITS, DEADLINE_S)
    try:
        *_, report = study(pool, 7, range(300))
        assert report.faults == []
        assert set(report.outcomes) > {"image", "undecodable-picture"}
        for name, data in bombs().items():
            try:
                image = pool.decode(data)
            except BadImage:
                continue
            assert image.width * image.height <= LIMITS.max_pixels, name
    finally:
        pool.close()


def test_a_number_makes_the_same_bytes_again() -> None:
    assert mutated(3, 41) == mutated(3, 41)
    assert mutated(3, 41) != mutated(3, 42)


def test_rare_forms_are_what_they_say() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (37, 70, 3), np.uint8)
    interlaced = interlaced_png(pixels)
    assert interlaced[28] == 1
    assert np.array_equal(decode(interlaced, LIMITS).pixels, pixels)
    for tiled in (tiled_tiff(pixels), tiled_tiff(pixels, "deflate"), tiled_tiff(pixels, planar=True)):
        assert np.array_equal(decode(tiled, LIMITS).pixels, pixels)
    [sequential, progressive, restarts] = (decode(data, LIMITS).pixels for data in arithmetic_jpegs().values())
    assert np.array_equal(sequential, progressive)
    assert np.array_equal(sequential, restarts)
    assert sequential.std() > 20
    structures = [Structure.read(data) for data in arithmetic_jpegs().values()]
    frames = [{segment.marker for segment in one.segments} & {0xC9, 0xCA} for one in structures if one]
    assert frames == [{0xC9}, {0xCA}, {0xC9}]  # arithmetic, sequential and progressive (T.81, table B.1)


def test_a_tile_that_asks_for_much_memory_is_refused_before_it_gets_any() -> None:
    """A TIFF of 2 kB whose tiles are 16,777,024 pixels wide, while its image is small: it took 540 MB."""
    tiled = tiled_tiff(np.zeros((64, 96, 1), np.uint8), "jpeg")
    at = tiled.index(struct.pack("<HHII", 322, 4, 1, 64)) + 8
    data = tiled[:at] + struct.pack("<I", 16_777_024) + tiled[at + 4 :]
    pool = DecoderPool(1, LIMITS, DEADLINE_S)
    try:
        pool.decode(tiled)
        before = peak_memory_mb(pool.processes[0].pid)
        with pytest.raises(BadImage, match="16777024 x 32"):
            pool.decode(data)
        assert 20 < before <= peak_memory_mb(pool.processes[0].pid) < before + 20
    finally:
        pool.close()


def test_memory_is_of_the_decoder_and_bounded() -> None:
    pool = DecoderPool(1, LIMITS, DEADLINE_S)
    try:
        *_, report = study(pool, 7, range(30))
        assert 20 < report.peak_mb < 1000, report.peak_of
        assert report.peak_of
    finally:
        pool.close()
    assert peak_memory_mb(None) == 0
