"""The use-case `statistics`: what the metrics show and nothing counts when it happens."""

import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from schemas.statistics import IndexLag, ServiceStatistics, StoreStatistics


class IndexRevisions(Protocol):
    """The indexes in memory."""

    def revisions(self) -> Mapping[str, int]:
        """The revision of each loaded index by map."""
        ...


class StatisticsService:
    """Gathers the statistics of a service. Not for several threads at once.

    Parameters
    ----------
    store : function
        Returns the statistics of the database.
    indexes : IndexRevisions
    data : Path
        The data folder.
    heartbeat_ages : function
        Returns the seconds since each worker's last sign of life.
    """

    def __init__(
        self,
        *,
        store: Callable[[], StoreStatistics],
        indexes: IndexRevisions,
        data: Path,
        heartbeat_ages: Callable[[], tuple[float, ...]],
    ) -> None:
        self._store, self._indexes, self._data, self._heartbeat_ages = store, indexes, data, heartbeat_ages
        self._behind_since: dict[str, float] = {}

    def gather(self, now_s: float | None = None) -> ServiceStatistics:
        """The statistics now; `now_s` is a reading of a monotonic clock."""
        store = self._store()
        disk = shutil.disk_usage(self._data)
        return ServiceStatistics(
            store=store,
            index_lags=self._lags(store, time.monotonic() if now_s is None else now_s),
            disk_free_bytes=disk.free,
            disk_total_bytes=disk.total,
            heartbeat_ages_s=self._heartbeat_ages(),
        )

    def _lags(self, store: StoreStatistics, now_s: float) -> dict[str, IndexLag]:
        held = self._indexes.revisions()
        lags = {one.name: max(0, one.revision - held[one.name]) for one in store.maps if one.name in held}
        self._behind_since = {name: self._behind_since.get(name, now_s) for name, lag in lags.items() if lag}
        return {name: IndexLag(lag, now_s - self._behind_since.get(name, now_s)) for name, lag in lags.items()}
