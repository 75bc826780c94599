"""Bounds on connections: how many there are, and how long each part of a request may take."""

from dataclasses import dataclass

from schemas.settings import MEGA, Settings

MOST_HEAD_BYTES = 64 * 1024
"""Bytes that request line and headers may have together."""

SLOWEST_BYTES_S = 50_000
"""Bytes a second that extend the time for a body: a large image over a slow link arrives, a trickle does not."""

IDLE_S = 5.0
"""Seconds for which a connection may be silent between requests, or while an unwanted body is thrown away."""

STALLED_S = 20.0
"""Seconds without progress after which an answer that the client does not read is given up."""

PAUSED_S = 60.0
"""The same of an answer that is still being made, such as a snapshot, whose reader may be on a line that breaks off."""

LITTLE_BYTES = 2_000_000
"""Of an answer that is given up last where all answers take too much memory; a snapshot has less at once."""

RESERVE = 64
"""Connections beyond the bound that are still read: enough to answer each with 503, and to answer the probes."""

CROWDED = "crowded"
"""Key of a request's state: its connection is beyond the bound, and all but the probes are refused."""


@dataclass(frozen=True)
class ConnectionLimits:
    """What one connection may take.

    Parameters
    ----------
    connections : int
        Connections that are served; those beyond are answered 503.
    head_s : float
        Seconds for the request line and the headers.
    discard_s : float
        Seconds for which the rest of a refused body is thrown away before the connection is broken.
    discard_bytes : int
        Bytes of a refused body that are thrown away at most.
    unsent_bytes : int
        Bytes of all answers together that wait for their clients to read them.
    """

    connections: int
    head_s: float
    discard_s: float
    discard_bytes: int
    unsent_bytes: int

    @classmethod
    def of(cls, settings: Settings) -> "ConnectionLimits":
        """The limits that the settings ask for."""
        discarded = round(4 * settings.max_body_mb * MEGA)
        unsent = round(settings.bodies_mb * MEGA)
        return cls(settings.connections, settings.head_s, settings.body_s, discarded, unsent)
