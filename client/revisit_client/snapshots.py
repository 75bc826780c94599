"""Calls of the client about snapshots."""

import os
import uuid
from functools import partial
from pathlib import Path

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import address, texts
from revisit_client.recordings import Body, pieces_of

CHUNK = 1 << 20

SNAPSHOT_TYPE = "application/x-tar"


class SnapshotCalls:
    """The part of `Revisit` that makes, fetches and restores snapshots."""

    _connection: Connection

    def make_snapshot(self, map: str) -> wire.Job:
        """Make a snapshot of a map in the background; `download_snapshot` fetches it under the id of the job."""
        return self._connection.receive(wire.Job, "POST", address("maps", map, "snapshots"), repeat=False)

    def snapshots(self) -> list[wire.Snapshot]:
        """All snapshots that the service keeps, newest first."""
        return self._connection.receive(wire.Snapshots, "GET", "/snapshots").snapshots

    def download_snapshot(self, snapshot_id: str, path: str | os.PathLike[str]) -> Path:
        """Write the file of a snapshot to `path`, which must not exist; there is all of it or nothing.

        Where the connection breaks it goes on from there, as long as something comes within `patience` seconds.

        Raises
        ------
        FileExistsError
        RevisitProblem, Unreachable
        """
        target = Path(path)
        _refuse_existing(target)
        unfinished = target.with_name(f".{uuid.uuid4().hex}.unfinished")  # another download may be under way to `path`
        try:
            with unfinished.open("xb") as file:
                for chunk in self._connection.stream(address("snapshots", snapshot_id)):
                    file.write(chunk)
                file.flush()
                os.fsync(file.fileno())
            _refuse_existing(target)
            unfinished.rename(target)
        finally:
            unfinished.unlink(missing_ok=True)
        return target

    def delete_snapshot(self, snapshot_id: str) -> wire.Snapshot:
        """Remove a snapshot from the service."""
        return self._connection.receive(wire.Snapshot, "DELETE", address("snapshots", snapshot_id))

    def restore(self, path: str | os.PathLike[str], *, name: str | None = None) -> wire.RestoredMap:
        """Make a map from the file of a snapshot.

        Parameters
        ----------
        path : path
        name : str or None
            Of the new map; None for the name that it had.
        """
        source = Path(path)
        headers = {"content-type": SNAPSHOT_TYPE, "content-length": str(source.stat().st_size)}
        return self._connection.receive(
            wire.RestoredMap,
            "POST",
            "/restore",
            params=texts({"as": name}),
            content=Body(partial(pieces_of, source)),
            headers=headers,
            timeout=self._connection.until_stored,
            repeat=False,
        )


def _refuse_existing(target: Path) -> None:
    if target.exists():
        raise FileExistsError(17, "exists already", str(target))
