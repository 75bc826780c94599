"""Sizes and states of a running service, as its metrics show them."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class MapStatistics:
    """One map.

    Parameters
    ----------
    name : str
    revision : int
        Of the map in the database.
    views : mapping of state to number of views
    image_bytes : int
        Bytes of its views' images.
    uncompared : int
        Views that wait for the comparison with their map.
    """

    name: str
    revision: int
    views: Mapping[str, int]
    image_bytes: int
    uncompared: int


@dataclass(frozen=True)
class QueueStatistics:
    """Unfinished jobs of one kind.

    Parameters
    ----------
    kind : str
        describe, redescribe (describing anew after a change of recipe), or the kind of a job of a map.
    waiting, running : int
    oldest_s : float
        Seconds that the oldest waiting job has waited; 0 when none waits.
    """

    kind: str
    waiting: int
    running: int
    oldest_s: float


@dataclass(frozen=True)
class StoreStatistics:
    """The database: its maps, its queues, and its size.

    Parameters
    ----------
    maps : tuple of MapStatistics
    queues : tuple of QueueStatistics
    database_bytes : int
    free_inodes : int or None
        Files that can still be made on the file system of images or database that takes fewer; None without a limit.
    """

    maps: tuple[MapStatistics, ...]
    queues: tuple[QueueStatistics, ...]
    database_bytes: int
    free_inodes: int | None = None


@dataclass(frozen=True)
class IndexLag:
    """How far the index of a map is behind the database.

    Parameters
    ----------
    revisions : int
        Revision of the database minus that of the index; the next query of the map catches up.
    seconds : float
        Since the index was first seen behind; 0 when it is not.
    """

    revisions: int
    seconds: float


@dataclass(frozen=True)
class ServiceStatistics:
    """Everything that is counted when somebody asks, rather than when it happens.

    Parameters
    ----------
    store : StoreStatistics
    index_lags : mapping of map to IndexLag
        Only maps whose index is loaded: it is built by the first query.
    disk_free_bytes, disk_total_bytes : int
        Of the file system of the data folder, for a process without privileges.
    heartbeat_ages_s : tuple of float
        Seconds since each worker's last sign of life.
    """

    store: StoreStatistics
    index_lags: Mapping[str, IndexLag] = field(default_factory=dict)
    disk_free_bytes: int = 0
    disk_total_bytes: int = 0
    heartbeat_ages_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class LiveStatistics:
    """What is known without asking the database.

    Parameters
    ----------
    queries_waiting : int
        Queries in the encoder's queue or in the encoder.
    encoder_alive : bool
    worker_alive : bool or None
        The worker inside the service; None when other processes describe images.
    decoder_restarts : int
        Times that the process that decodes images was started anew.
    """

    queries_waiting: int
    encoder_alive: bool
    worker_alive: bool | None
    decoder_restarts: int = 0
