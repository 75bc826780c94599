"""The gauges of `/metrics`: sizes and states, gathered in a thread of their own and kept for a while."""

import asyncio
import logging
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from schemas.settings import Settings
from schemas.statistics import LiveStatistics, MapStatistics, ServiceStatistics
from schemas.threads import Threads
from schemas.wire import Version

logger = logging.getLogger("revisit.http")

MAPS = 20
"""Maps with series of their own, the largest; the others share one."""

OTHER = "(other)"
"""Label of the maps that share series; no map can have this name."""

PATIENCE_S = 0.4
"""Seconds that a call waits for new statistics before it gets the last ones."""

FRESH_S = 5.0
"""Seconds for which statistics are not gathered again."""

SHARE = 20
"""Gathering takes at most one second of this many."""


class StatisticsReader:
    """Gathers statistics without making anybody wait.

    Parameters
    ----------
    gather : function
        Gathers them; may be slow or hang. Runs in one thread of its own.
    """

    def __init__(self, gather: Callable[[], ServiceStatistics]) -> None:
        self._gather = gather
        self._thread = Threads(1, "revisit-statistics")
        self._running: Future[ServiceStatistics | None] | None = None
        self._last: ServiceStatistics | None = None
        self._gathered_at: float | None = None
        self._due_at = 0.0

    async def read(self) -> tuple[ServiceStatistics | None, float]:
        """The statistics (None before the first) and their age in seconds; returns within `PATIENCE_S`.

        Before the first the age is that of the first call: how long they have been missing.
        """
        if self._gathered_at is None:
            self._gathered_at = time.monotonic()
        if self._running is None and time.monotonic() >= self._due_at:
            self._running = self._thread.submit(self._timed)
        if self._running is not None:
            await asyncio.wait([asyncio.wrap_future(self._running)], timeout=PATIENCE_S)
            if self._running is not None and self._running.done():
                running, self._running = self._running, None
                self._last = running.result() or self._last
        return self._last, time.monotonic() - self._gathered_at

    def _timed(self) -> ServiceStatistics | None:
        """The statistics; None where they could not be gathered, which is logged."""
        began = time.monotonic()
        try:
            statistics = self._gather()
            self._gathered_at = began
            return statistics
        except Exception as error:  # the gauges keep their last values, and their age tells of it
            why = getattr(error, "detail", type(error).__name__)
            logger.warning("the gauges are not gathered: %s", why, extra={"event": "gauges_failed"})
            return None
        finally:
            ended = time.monotonic()
            self._due_at = ended + max(FRESH_S, SHARE * (ended - began))

    def close(self) -> None:
        """End the thread, without waiting for what it gathers."""
        self._thread.shutdown(wait=False, cancel_futures=True)


class StatisticsCollector(Collector):
    """Turns the statistics that it was given last into metrics."""

    def __init__(self) -> None:
        self.statistics: ServiceStatistics | None = None
        self.age_s: float | None = None
        self.live: LiveStatistics | None = None
        self.state = "starting"
        self.version: Version | None = None
        self.settings: Settings | None = None

    def describe(self) -> list[Metric]:
        """Nothing, so that registering does not collect."""
        return []

    def collect(self) -> Iterator[Metric]:
        """All gauges; those that nothing is known of have no samples."""
        yield from self._service()
        yield from self._live()
        yield from self._queues()
        yield from self._maps()
        yield from self._disk()

    def _service(self) -> Iterator[Metric]:
        build = _gauge("build_info", "Versions; always 1.", "version", "encoder", "weights", "python")
        if (known := self.version) is not None:
            build.add_metric([known.version, known.encoder, known.weights[:12], known.python], 1)
        yield build
        state = _gauge("state", "1 for the present state of the service.", "state")
        for name in ("starting", "ready", "draining"):
            state.add_metric([name], float(name == self.state))
        yield state
        limits = _gauge("queue_limit", "Waiting requests after which more are refused.", "queue")
        if self.settings is not None:
            limits.add_metric(["enrolments"], self.settings.queue)
            limits.add_metric(["queries"], self.settings.queries)
        yield limits
        age = _gauge("statistics_age_seconds", "Age of the gauges that are read from the database.")
        if self.age_s is not None:
            age.add_metric([], self.age_s)
        yield age

    def _live(self) -> Iterator[Metric]:
        live = self.live
        waiting = _gauge("queries_waiting", "Queries that wait to be encoded, or are encoded.")
        alive = _gauge("thread_alive", "1 while this thread of the service runs.", "thread")
        restarts = CounterMetricFamily("revisit_decoder_restarts", "Starts of a new decoder after one ended.")
        if live is not None:
            waiting.add_metric([], live.queries_waiting)
            alive.add_metric(["encoder"], float(live.encoder_alive))
            if live.worker_alive is not None:
                alive.add_metric(["worker"], float(live.worker_alive))
            restarts.add_metric([], live.decoder_restarts)
        yield from (waiting, alive, restarts)
        workers = _gauge("workers", "Workers that write a sign of life.")
        beat = _gauge("worker_heartbeat_age_seconds", "Since the latest sign of life of any worker.")
        if self.statistics is not None:
            ages = self.statistics.heartbeat_ages_s
            workers.add_metric([], len(ages))
            if ages:
                beat.add_metric([], min(ages))
        yield from (workers, beat)

    def _queues(self) -> Iterator[Metric]:
        jobs = _gauge("jobs", "Unfinished jobs.", "kind", "state")
        oldest = _gauge("oldest_waiting_job_age_seconds", "Age of the oldest waiting job; 0 when none waits.", "kind")
        for queue in () if self.statistics is None else self.statistics.store.queues:
            jobs.add_metric([queue.kind, "waiting"], queue.waiting)
            jobs.add_metric([queue.kind, "running"], queue.running)
            oldest.add_metric([queue.kind], queue.oldest_s)
        yield from (jobs, oldest)

    def _maps(self) -> Iterator[Metric]:
        maps = _gauge("maps", "Maps.")
        views = _gauge("views", "Views.", "map", "state")
        revision = _gauge("map_revision", "Revision of a map in the database.", "map")
        uncompared = _gauge("comparisons_pending", "Views to be compared with the others of their map.", "map")
        images = _gauge("image_bytes", "Bytes of the images of all views.", "map")
        lag = _gauge("index_lag_revisions", "Revision of the database minus that of the loaded index.", "map")
        since = _gauge("index_lag_seconds", "Since the index was first seen behind the database.", "map")
        known = self.statistics
        if known is not None:
            maps.add_metric([], len(known.store.maps))
            largest = sorted(known.store.maps, key=lambda one: (-sum(one.views.values()), one.name))
            for one in [*largest[:MAPS], *_together(largest[MAPS:])]:
                for state, count in one.views.items():
                    views.add_metric([one.name, state], count)
                uncompared.add_metric([one.name], one.uncompared)
                images.add_metric([one.name], one.image_bytes)
                if one.name != OTHER:
                    revision.add_metric([one.name], one.revision)
                if one.name in known.index_lags:
                    lag.add_metric([one.name], known.index_lags[one.name].revisions)
                    since.add_metric([one.name], known.index_lags[one.name].seconds)
        yield from (maps, views, revision, uncompared, images, lag, since)

    def _disk(self) -> Iterator[Metric]:
        database = _gauge("database_bytes", "Bytes of the database on disk.")
        free = _gauge("disk_free_bytes", "Free bytes of the file system of the data folder.")
        total = _gauge("disk_size_bytes", "Size of the file system of the data folder.")
        inodes = _gauge("disk_free_inodes", "Files that the file system of images or database still takes.")
        if self.statistics is not None:
            database.add_metric([], self.statistics.store.database_bytes)
            free.add_metric([], self.statistics.disk_free_bytes)
            total.add_metric([], self.statistics.disk_total_bytes)
            if self.statistics.store.free_inodes is not None:
                inodes.add_metric([], self.statistics.store.free_inodes)
        yield from (database, free, total, inodes)


def _gauge(name: str, text: str, *labels: str) -> GaugeMetricFamily:
    return GaugeMetricFamily(f"revisit_{name}", text, labels=labels)


def _together(maps: list[MapStatistics]) -> list[MapStatistics]:
    """The sum of some maps as one, or nothing."""
    if not maps:
        return []
    views: dict[str, int] = {}
    for one in maps:
        for state, count in one.views.items():
            views[state] = views.get(state, 0) + count
    return [MapStatistics(OTHER, 0, views, sum(m.image_bytes for m in maps), sum(m.uncompared for m in maps))]
