"""An image on its way from a topic to the service."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

LEAST_UNIX_S = 100_000_000
"""Smallest stamp that counts as Unix time: a simulation counts from its start."""


@dataclass(frozen=True)
class Shot:
    """One image.

    Parameters
    ----------
    seconds, nanoseconds : int
        The stamp of its header, which comes back on what is published.
    frame : str
        The camera's frame.
    read : callable
        The bytes of an image file; raises `encoding.Unusable`. Called beside the executor, since it may take a while.
    arrived : float
        Seconds of the node's clock, which never goes back.
    """

    seconds: int
    nanoseconds: int
    frame: str
    read: Callable[[], bytes]
    arrived: float

    @property
    def stamp(self) -> str:
        """As text, with nanoseconds."""
        return f"{self.seconds}.{self.nanoseconds:09d}"

    def captured_at(self) -> datetime | None:
        """The stamp as a time; None where it is that of a simulation."""
        if self.seconds < LEAST_UNIX_S:
            return None
        return datetime.fromtimestamp(self.seconds, UTC).replace(microsecond=self.nanoseconds // 1000)
