"""A bounded memory of what was used last."""

import threading
from collections import OrderedDict
from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class Latest(OrderedDict[K, V]):
    """The values that were set last; of more than `most` the first goes. Threads may set values at once.

    Parameters
    ----------
    most : int
    """

    def __init__(self, most: int) -> None:
        super().__init__()
        self._most, self._setting = most, threading.Lock()

    def __setitem__(self, key: K, value: V) -> None:
        with self._setting:
            super().__setitem__(key, value)
            self.move_to_end(key)
            while len(self) > self._most:
                self.popitem(last=False)
