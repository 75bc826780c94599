"""Panoramas of a recording, each as several views."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from schemas.image import Image
from schemas.latest import Latest
from worker.images import panorama
from worker.service.recordings import Item

KEPT = 3
"""Panoramas whose views are kept: those whose views are being read."""


class Panoramas:
    """Makes the views of panoramas when the first of them is read, and keeps them until the last is.

    Parameters
    ----------
    decode : function
        Bytes to Image; raises BadImage.
    """

    def __init__(self, decode: Callable[[bytes], Image]) -> None:
        self._decode = decode
        self._views: Latest[int, list[bytes]] = Latest(KEPT)  # by the place of the panorama in the recording
        self._lock = threading.Lock()

    def split(self, items: Sequence[Item]) -> list[Item]:
        """The views of all panoramas, named by the direction in which they look from the middle."""
        return [
            replace(
                item,
                file=f"{item.file}#{turn:03.0f}",
                read=partial(self._view, at, item, number),
                original=item.read,
                turn=turn,
            )
            for at, item in enumerate(items)
            for number, turn in enumerate(panorama.turns())
        ]

    def _view(self, at: int, item: Item, number: int) -> bytes:
        with self._lock:  # the views of one panorama are read at once, and are to be made once
            if at not in self._views:
                self._views[at] = panorama.views(self._decode(item.read()).pixels)
            return self._views[at][number]
