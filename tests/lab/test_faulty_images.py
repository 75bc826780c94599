"""Three hundred mutated pictures and every bomb: an image or a refusal, in time, and the decoders live."""

import pytest

from lab.faults.images import DEADLINE_S, LIMITS, bombs, mutated, sound, study
from schemas.errors import BadImage
from worker.images.apart.pool import DecoderPool
from worker.images.codec import decode

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
