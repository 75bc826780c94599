"""Which snapshots have images, or descriptions of them, that were deleted from the maps."""

import threading
from collections import OrderedDict
from collections.abc import Collection, Sequence

from schemas.errors import BadSnapshot, RevisitError
from schemas.removal import Holding
from schemas.snapshot import SnapshotFacts
from worker.storage.disk_errors import translated
from worker.storage.image_files import DIGEST
from worker.storage.rows import log
from worker.storage.snapshot_places import SnapshotPlace

KNOWN = 8
"""Files whose contents are remembered."""

UNKNOWN = "unknown"
"""In place of an id, where an object store does not tell which snapshots there are."""

Contents = tuple[SnapshotFacts, frozenset[bytes]]
"""What a snapshot is, and the SHA-256 of the images of its views."""


class SnapshotContents:
    """Looks into the snapshots of a place.

    Parameters
    ----------
    place : SnapshotPlace
    """

    def __init__(self, place: SnapshotPlace) -> None:
        self._place = place
        self._known: OrderedDict[tuple[str, tuple[int, ...]], Contents] = OrderedDict()
        self._lock = threading.Lock()

    def holding(self, digests: Collection[str], started: Sequence[str]) -> tuple[Holding, ...]:
        """Snapshots that have images with these SHA-256, newest first; those that cannot be told come last.

        Called after a deletion, which it must not make fail: what cannot be read is told, and logged.

        Parameters
        ----------
        digests : collection of str
        started : sequence of str
            Ids of snapshots that were being made when the deletion began.
        """
        wanted = [bytes.fromhex(digest) for digest in digests if DIGEST.fullmatch(digest)]
        found, unknown = [], []
        try:
            with translated("snapshots"):
                kept = self._place.ids()
        except RevisitError as error:
            log.error("which snapshots have what was deleted is not known: %s", error.detail)
            kept, unknown = [], [Holding(UNKNOWN, None, None, None)]
        for snapshot_id in kept:
            try:
                with translated("snapshots"):
                    facts, inside = self._of(snapshot_id)
            except FileNotFoundError:  # removed meanwhile
                continue
            except RevisitError as error:
                log.error("whether the snapshot %s has what was deleted is not known: %s", snapshot_id, error.detail)
                unknown.append(Holding(snapshot_id, None, None, None))
                continue
            if held := sum(digest in inside for digest in wanted):
                found.append((facts.created_at, Holding(snapshot_id, facts.map, facts.created_at, held)))
        unknown += [Holding(one, None, None, None) for one in started if one not in kept]
        return tuple([one for _, one in sorted(found, key=lambda pair: pair[0], reverse=True)] + unknown)

    def _of(self, snapshot_id: str) -> Contents:
        """Contents of a snapshot; raises BadSnapshot, StorageFailed, OSError."""
        key = snapshot_id, self._place.stamp(snapshot_id)
        with self._lock:
            if key in self._known:
                self._known.move_to_end(key)
                return self._known[key]
        try:
            contents = self._place.facts(snapshot_id)[0], self._place.digests(snapshot_id)
        except ValueError as error:
            raise BadSnapshot(f"it cannot be read: {error}") from error
        with self._lock:
            self._known[key] = contents
            while len(self._known) > KNOWN:
                self._known.popitem(last=False)
        return contents
