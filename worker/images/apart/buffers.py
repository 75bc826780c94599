"""Memory that decoded images lie in, used again: fresh memory takes the system longer to give than pixels to copy."""

import sys
import threading

import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]

SMALLEST = 1 << 20
"""Bytes below which fresh memory is as quick."""


_ALONE = [np.empty(0, np.uint8)]
UNUSED = sys.getrefcount(_ALONE[0])
"""References to an array that only a list holds."""


class Buffers:
    """A few kept buffers; one is free when no array that was made from it is left.

    Parameters
    ----------
    count : int
        Kept at most.
    largest : int
        Bytes of the largest that is kept; more is made and given back each time.
    """

    def __init__(self, count: int, largest: int) -> None:
        self._count, self._largest = count, largest
        self._kept: list[Bytes] = []
        self._lock = threading.Lock()

    def copy(self, pixels: Bytes) -> Bytes:
        """A copy of an array, in a kept buffer if one is free."""
        if not SMALLEST <= pixels.size <= self._largest:
            return pixels.copy()
        with self._lock:
            room = self._free(pixels.size)[: pixels.size]
        copied = room.reshape(pixels.shape)
        del room
        np.copyto(copied, pixels)
        return copied

    def _free(self, size: int) -> Bytes:
        """A buffer of at least `size` bytes that nothing uses."""
        for number in range(len(self._kept)):
            # Arrays made from slices of a buffer refer to the buffer itself.
            if sys.getrefcount(self._kept[number]) == UNUSED:
                if self._kept[number].size < size:
                    self._kept[number] = np.empty(size, np.uint8)
                return self._kept[number]
        fresh = np.empty(size, np.uint8)
        if len(self._kept) < self._count:
            self._kept.append(fresh)
        return fresh
