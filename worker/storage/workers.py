"""Workers: their signs of life, and what becomes of the jobs of those that gave none.

A worker counts its signs of life in its row. Whoever watches compares the counts, not times: clocks of hosts differ,
and are set. Jobs of a worker without a row go back to the queue; a late worker finds its claim void, so that no
description is stored twice.
"""

from collections.abc import Collection
from datetime import datetime
from typing import get_args

import sqlalchemy as sa

from schemas.records import Failure, JobKind, WorkerRecord
from worker.storage import forgetting
from worker.storage.jobs import ATTEMPTS, WORKER_DIED
from worker.storage.shadow_jobs import ShadowJobs
from worker.storage.tables import JOBS, WORKERS

_ABANDONED = sa.and_(
    JOBS.c.kind.in_(get_args(JobKind)),  # for the index: finished jobs are many
    JOBS.c.state == "running",
    JOBS.c.token.is_not(None),
    JOBS.c.worker.not_in(sa.select(WORKERS.c.name)),
)
_MINE = WORKERS.c.name == sa.bindparam("of")


class Workers(ShadowJobs):
    """Signs of life of workers."""

    def beat(self, worker: WorkerRecord, now: datetime) -> list[WorkerRecord]:
        """Give a sign of life; returns all workers."""
        with self._database.writing(in_turn=False, durable=False, frees=True) as connection:
            counted = sa.update(WORKERS).where(_MINE).values(beats=WORKERS.c.beats + 1, seen_at=now)
            if connection.execute(counted, {"of": worker.name}).rowcount == 0:
                first = {**vars(worker), "beats": 1}
                connection.execute(sa.insert(WORKERS).values(started_at=now, seen_at=now, **first))
        return self.present()

    def present(self) -> list[WorkerRecord]:
        """All workers that have a row."""
        with self._database.reading() as connection:
            rows = connection.execute(sa.select(WORKERS).order_by(WORKERS.c.name))
            return [WorkerRecord(row.name, row.kind, row.host, row.pid, row.beats, row.encoder) for row in rows]

    def bury(self, names: Collection[str], now: datetime) -> int:
        """Remove workers, and put the jobs of workers without a row back; returns how many jobs.

        A job that three workers left so is failed.
        """
        with self._database.reading() as connection:
            if not names and connection.execute(sa.select(JOBS.c.number).where(_ABANDONED).limit(1)).first() is None:
                return 0
        with self._database.writing(frees=True) as connection:
            connection.execute(sa.delete(WORKERS).where(WORKERS.c.name.in_(list(names))))
            left = list(connection.execute(sa.select(JOBS).where(_ABANDONED).with_for_update()))
            changed_over = set()
            for job in left:
                if job.kind == "describe" and job.attempts >= ATTEMPTS:
                    if self.settle(connection, job, "failed", now, Failure("worker-died", WORKER_DIED)) is not None:
                        changed_over.add(job.map_id)
                    continue
                back = {"state": "waiting", "worker": None, "token": None}
                connection.execute(sa.update(JOBS).where(JOBS.c.number == job.number).values(**back))
        for map_id in changed_over:
            forgetting.remove_after_switch(self._database, self._images, map_id)
        return len(left)
