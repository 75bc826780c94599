"""Which snapshots have images, or descriptions of them, that were deleted from the maps."""

import threading
from collections.abc import Collection, Iterable, Sequence

import numpy as np
import numpy.typing as npt

from schemas.errors import BadSnapshot, RevisitError
from schemas.removal import Holding
from schemas.snapshot import SnapshotFacts
from worker.storage.disk_errors import translated
from worker.storage.image_files import DIGEST
from worker.storage.rows import log
from worker.storage.snapshot_places import SnapshotPlace

BEGINNING = 8
"""Bytes of each SHA-256 that are remembered. Among a billion images, two begin alike with a probability of 0.03."""

MOST_BYTES = 128 << 20
"""Bytes of all contents that are remembered: 160 snapshots of 100,000 views. Each deletion reads further ones anew."""

UNKNOWN = "unknown"
"""In place of an id, where an object store does not tell which snapshots there are."""

Beginnings = npt.NDArray[np.uint64]

Contents = tuple[SnapshotFacts, Beginnings]
"""What a snapshot is, and how the SHA-256 of the images of its views begin."""


class SnapshotContents:
    """Looks into the snapshots of a place.

    Parameters
    ----------
    place : SnapshotPlace
    """

    def __init__(self, place: SnapshotPlace) -> None:
        self._place = place
        self._known: dict[str, tuple[tuple[int, ...], Contents]] = {}
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
        wanted = _beginnings(bytes.fromhex(digest) for digest in digests if DIGEST.fullmatch(digest))
        found, unknown = [], []
        try:
            with translated("snapshots"):
                kept = self._place.ids()
            self._forget_all_but(kept)
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
            if held := int(np.isin(wanted, inside).sum()):
                found.append((facts.created_at, Holding(snapshot_id, facts.map, facts.created_at, held)))
        unknown += [Holding(one, None, None, None) for one in started if one not in kept]
        return tuple([one for _, one in sorted(found, key=lambda pair: pair[0], reverse=True)] + unknown)

    def _of(self, snapshot_id: str) -> Contents:
        """Contents of a snapshot; raises BadSnapshot, StorageFailed, OSError."""
        stamp = self._place.stamp(snapshot_id)
        with self._lock:
            known = self._known.get(snapshot_id)
        if known is not None and known[0] == stamp:
            return known[1]
        try:
            contents = self._place.facts(snapshot_id)[0], _beginnings(self._place.digests(snapshot_id))
        except ValueError as error:
            raise BadSnapshot(f"it cannot be read: {error}") from error
        with self._lock:
            self._known.pop(snapshot_id, None)
            if sum(inside.nbytes for _, (_, inside) in self._known.values()) + contents[1].nbytes <= MOST_BYTES:
                self._known[snapshot_id] = stamp, contents
        return contents

    def _forget_all_but(self, kept: Collection[str]) -> None:
        """Forget the contents of snapshots that were removed."""
        with self._lock:
            for snapshot_id in self._known.keys() - set(kept):
                del self._known[snapshot_id]


def _beginnings(digests: Iterable[bytes]) -> Beginnings:
    """How SHA-256 begin, uint64 of shape (n,)."""
    return np.frombuffer(b"".join(digest[:BEGINNING] for digest in digests), np.uint64)
