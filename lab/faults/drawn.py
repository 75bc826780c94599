"""Small drawn images by number: another number is another place, and each is found again among thousands."""

import hashlib
from functools import lru_cache

import cv2
import numpy as np

TYPE = {"content-type": "image/png"}


@lru_cache(maxsize=4096)
def image(number: int) -> bytes:
    """A PNG of 64 x 48 pixels, 6 x 8 blocks of random colours, that no other number has."""
    blocks = np.random.default_rng(number).integers(0, 256, (6, 8, 3), np.uint8)
    pixels = cv2.resize(blocks, (64, 48), interpolation=cv2.INTER_NEAREST)
    return bytes(cv2.imencode(".png", pixels)[1])


def digest(data: bytes) -> str:
    """SHA-256 of bytes, hex."""
    return hashlib.sha256(data).hexdigest()
