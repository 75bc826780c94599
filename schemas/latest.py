"""A bounded memory of what was used last."""

import threading
from collections import OrderedDict
from collections.abc import Callable
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
        self._making: dict[K, threading.Lock] = {}

    def __setitem__(self, key: K, value: V) -> None:
        with self._setting:
            super().__setitem__(key, value)
            self.move_to_end(key)
            while len(self) > self._most:
                self.popitem(last=False)

    def get_or_make(self, key: K, make: Callable[[], V]) -> V:
        """The value of a key, which counts as set now; made if there is none, while others that want it wait.

        Where making it fails, each of those that wait tries for itself, one after the other.
        """
        with self._setting:
            if key in self:
                self.move_to_end(key)
                return self[key]
            making = self._making.setdefault(key, threading.Lock())
        with making:
            try:
                with self._setting:
                    if key in self:
                        return self[key]
                made = self[key] = make()
                return made
            finally:
                with self._setting:
                    if self._making.get(key) is making:
                        del self._making[key]
