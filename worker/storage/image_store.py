"""What the store needs of the place where images lie, and the choice of it: a folder, or an S3-compatible store."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import sqlalchemy as sa

from schemas.errors import Damaged
from worker.storage import checksums
from worker.storage.database import Database
from worker.storage.image_files import Discarded, Images
from worker.storage.peers import ImageHold, image_lock
from worker.storage.rows import batches
from worker.storage.tables import JOBS, MAPS, VIEWS

if TYPE_CHECKING:
    from worker.storage.object_files import ObjectFiles


class ImageStore(Protocol):
    """Enrolled images, named by the SHA-256 of their bytes."""

    @property
    def files(self) -> "ObjectFiles | None":
        """The place of recordings and snapshots, beside the images; None: they lie in the data folder."""
        ...

    @property
    def prompt(self) -> "ObjectFiles | None":
        """The same place, for small files: its calls end within some 3 s."""
        ...

    def kept(self, digest: str, image: bytes) -> AbstractContextManager[ImageHold]:
        """Write an image durably, then run a block that commits a row with its digest, after `until_commit`."""
        ...

    def add(self, images: Mapping[str, bytes]) -> None:
        """Write images durably, by their digests; their rows are committed already. Raises DiskFull, StorageFailed."""
        ...

    def await_removals(self) -> None:
        """Wait for removals that may have begun before the rows which are committed now; raises StorageFailed."""
        ...

    def read(self, digest: str) -> bytes:
        """The bytes of an image, verified; raises Damaged, StorageFailed."""
        ...

    def read_each(self, digests: Sequence[str]) -> list[bytes | Damaged]:
        """The bytes of each image, or the Damaged that `read` would raise; raises StorageFailed."""
        ...

    def discard(self, digests: Iterable[str]) -> Discarded:
        """Remove images that no view needs, after their rows were deleted."""
        ...

    @property
    def left(self) -> frozenset[str]:
        """Digests of images that `discard` could not remove yet: they are to be given to it again."""
        ...

    def sweep(self) -> int:
        """Remove what a crash left; returns how many files."""
        ...

    def sweep_at_start(self) -> None:
        """`sweep`, or begin it; others may use the database and the images."""
        ...

    @property
    def owner_name(self) -> str:
        """Path or address of the file that `owner` reads."""
        ...

    def owner(self) -> str | None:
        """The id of the database that the images belong to; None where that is not recorded. Raises StorageFailed."""
        ...

    def claim(self, owner: str) -> None:
        """Record which database the images belong to; raises DiskFull, StorageFailed."""
        ...

    def holds_any(self) -> bool:
        """Whether there is an image, of a view or not; raises StorageFailed."""
        ...

    def problem(self) -> str | None:
        """Why images cannot be read or written now, or None."""
        ...

    def close(self) -> None:
        """End what goes on in the background."""
        ...


def forgets(connection: sa.Connection, map_id: int) -> bool:
    """Whether a map keeps no images: one whose settings are damaged keeps them."""
    return map_id in _forgetting(connection)


def needs_image(connection: sa.Connection) -> sa.ColumnElement[bool]:
    """SQL condition that a view's image is kept: its map keeps images, it is not described, or is to be once more."""
    forgetting = _forgetting(connection)
    if not forgetting:
        return sa.true()
    described_next = sa.exists().where(JOBS.c.seq == VIEWS.c.seq, JOBS.c.state.in_(("waiting", "running")))
    return VIEWS.c.map_id.not_in(forgetting) | (VIEWS.c.state != "ready") | described_next


def _forgetting(connection: sa.Connection) -> list[int]:
    """Maps that keep no images. Only whole rows count: a flipped bit must not cost a map its images."""
    rows = connection.execute(sa.select(MAPS).where(MAPS.c.drop_images.is_(True)))
    return [row.id for row in rows if checksums.is_whole(MAPS, row)]


def needed_by_views(database: Database, digests: list[str]) -> set[str]:
    """The digests among `digests` that views need."""
    with database.reading() as connection:
        return needed_among(connection, digests)


def needed_among(connection: sa.Connection, digests: list[str]) -> set[str]:
    """As `needed_by_views`, in a transaction."""
    found: set[str] = set()
    for portion in batches(digests):
        needed = sa.select(VIEWS.c.sha256).where(VIEWS.c.sha256.in_(portion), needs_image(connection))
        found.update(connection.scalars(needed))
    return found


def open_images(database: Database, data: Path, address: str | None) -> ImageStore:
    """The images of a service.

    Parameters
    ----------
    database : Database
        Says which images views need.
    data : Path
        Data folder.
    address : str or None
        ``s3://bucket/prefix``; None for the folder ``pictures`` in the data folder.

    Raises
    ------
    SetupError
        The address is of no store that revisit can use.
    """

    def owned(digests: list[str]) -> set[str]:
        return needed_by_views(database, digests)

    if address is None:
        return Images(data / "pictures", owned)
    from worker.storage.image_objects import ImageObjects  # loads boto3, which a folder does not need

    return ImageObjects(address, owned, image_lock(database, data))
