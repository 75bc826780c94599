"""Sweeps what crashes left of recordings and snapshots in an object store, which no one start could: it is shared."""

import re
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import sqlalchemy as sa

from schemas.errors import RevisitError
from worker.storage.database import Database
from worker.storage.rows import batches, log
from worker.storage.snapshot_places import DIGESTS, SNAPSHOTS, SUFFIX
from worker.storage.switching import UNFINISHED
from worker.storage.tables import JOBS
from worker.storage.uploads import IMPORTS

if TYPE_CHECKING:
    from worker.storage.object_files import ObjectFiles, Stored  # loads boto3, which a folder does not need

EVERY_S = 3600.0
"""Seconds between sweeps of one worker."""

OLD_S = 6 * 3600.0
"""Age from which a file without an unfinished job is left over: a recording is stored before the row of its job."""

_JOB = re.compile(f"(?:{IMPORTS}|{SNAPSHOTS})/([0-9a-f-]{{36}})[/.].*")


class Leftovers:
    """Sweeps now and then, by any worker that has nothing else to do.

    Parameters
    ----------
    database : Database
    files : ObjectFiles
    is_own : function
        Whether what lies there is of this database.
    """

    def __init__(self, database: Database, files: "ObjectFiles", is_own: Callable[[], bool]) -> None:
        self._database, self._files, self._is_own = database, files, is_own
        self._swept = -EVERY_S

    def step(self) -> bool:
        """Sweep if it is time to; returns whether something was removed."""
        if time.monotonic() - self._swept < EVERY_S:
            return False
        self._swept = time.monotonic()
        try:
            return self._is_own() and self.sweep() > 0
        except RevisitError as error:
            log.warning("files that a crash left in %s are not removed yet: %s", self._files.address, error.detail)
            return False

    def sweep(self, old_s: float = OLD_S) -> int:
        """Remove what no job needs and is older than this; returns how many files, or parts of one."""
        found = [one for one in self._all() if one.age_s >= old_s]
        needed = self._unfinished({job for one in found if (job := _job_of(one)) is not None})
        left = [one for one in found if (job := _job_of(one)) is not None and job not in needed]
        for one in left:
            self._files.remove(one.name, one.upload)
        if left:
            log.info("%d files of imports and snapshots that a crash left were removed", len(left))
        return len(left)

    def _all(self) -> Iterator["Stored"]:
        """What belongs to jobs: all of imports, and of snapshots what is beside one that is not there."""
        yield from self._files.below(IMPORTS)
        yield from self._files.unfinished(IMPORTS)
        kept = list(self._files.below(SNAPSHOTS))
        whole = {one.name.removesuffix(SUFFIX) for one in kept if one.name.endswith(SUFFIX)}
        yield from (one for one in kept if one.name.endswith(DIGESTS) and one.name.removesuffix(DIGESTS) not in whole)
        yield from self._files.unfinished(SNAPSHOTS)

    def _unfinished(self, jobs: set[str]) -> set[str]:
        """Those of these jobs that wait or run."""
        found: set[str] = set()
        with self._database.reading() as connection:
            for portion in batches(sorted(jobs)):
                wanted = sa.select(JOBS.c.id).where(JOBS.c.id.in_(portion), JOBS.c.state.in_(UNFINISHED))
                found.update(connection.scalars(wanted))
        return found


def _job_of(stored: "Stored") -> str | None:
    """The job that a file belongs to; None for one that is not of revisit."""
    named = _JOB.fullmatch(stored.name)
    return None if named is None else named[1]
