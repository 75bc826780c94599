"""Work that can wait gives way to queries."""

from collections.abc import Callable

QUIET_S = 0.05
"""Seconds without a query before the work goes on: callers that query again and again pause for less in between."""

LOOK_S = 0.02
"""Seconds between looks whether it is quiet."""

Rest = Callable[[float], bool]
"""Sleeps for a number of seconds; returns whether it was woken, since a job of a map waits."""


class GivingWay:
    """Lets queries go before one piece of work, for some seconds in all: it gets on beside any number of queries.

    Parameters
    ----------
    quiet_s : function
        Seconds since the last query was answered, 0 while one is under way.
    rest : Rest
    most_s : float
        Seconds.

    Attributes
    ----------
    waited_s : float
        Seconds that it has given way until now.
    """

    def __init__(self, quiet_s: Callable[[], float], rest: Rest, most_s: float) -> None:
        self._quiet_s, self._rest, self._most_s = quiet_s, rest, most_s
        self.waited_s = 0.0

    def __call__(self) -> None:
        """Wait until it is quiet, a job of a map waits, or it has waited enough."""
        while self.waited_s < self._most_s and self._quiet_s() < QUIET_S:
            if self._rest(LOOK_S):
                return
            self.waited_s += LOOK_S  # also where nothing rests
