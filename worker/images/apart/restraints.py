"""Limits that processes which decode set for themselves."""

import os
import resource
from contextlib import suppress
from typing import BinaryIO

from worker.images.codec import MEGA

FIXED_MEMORY = 512 * MEGA
"""Memory that decoding may take beyond `PIXEL_MEMORY` for each pixel, in bytes."""

PIXEL_MEMORY = 24
"""Bytes for each pixel: the largest images, with alpha and turned, take about sixteen."""


def restrict(max_pixels: int) -> None:
    """Give up what decoding does not need: memory without bound, growing files, core dumps, new processes."""
    wanted = {resource.RLIMIT_FSIZE: 0, resource.RLIMIT_CORE: 0, resource.RLIMIT_NPROC: 0, resource.RLIMIT_NOFILE: 16}
    with suppress(OSError), open("/proc/self/statm") as file:
        held = int(file.read().split()[0]) * resource.getpagesize()
        wanted[resource.RLIMIT_AS] = held + FIXED_MEMORY + PIXEL_MEMORY * max_pixels
    for limit, value in wanted.items():
        with suppress(ValueError, OSError):  # a limit that the system does not have, or a stricter one is set
            resource.setrlimit(limit, (value, value))


def take_stdout() -> BinaryIO:
    """Standard output for answers alone: what libraries print goes to standard error from now on."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers
