"""Descriptions: written whole, read in the parts that an index and a ranking need."""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar
from zlib import crc32

import numpy as np
import sqlalchemy as sa

from schemas.description import Appearance, Description, Floats, Int8s, LocalFeatures
from schemas.image import extent_of
from schemas.recipe import DescriptionRecipe
from schemas.records import Changes, Sequence64
from worker.storage import checksums, clock, dialect, packing
from worker.storage.damage import description_fault, vectors_size
from worker.storage.part import Part
from worker.storage.rows import batches, find_map, find_recipe, inserting
from worker.storage.tables import APPEARANCES, CELLS, DESCRIPTIONS, KEYPOINTS, TOMBSTONES, VECTORS, VIEWS

Unpacked = TypeVar("Unpacked")

ROWS = 4096
"""Descriptions read at a time."""


def keep_description(
    connection: sa.Connection, job: sa.Row[Any], recipe: DescriptionRecipe, description: Description, revision: int
) -> None:
    """Store the description of a job's view, as of a revision of the map."""
    key = {"seq": job.seq, "recipe": job.recipe}
    facts = {
        **key,
        "map_id": job.map_id,
        "revision": revision,
        "descriptor_count": int(description.descriptor_count),
        "static_share": float(description.static_share),
        "nodes": len(description.appearance.graph),
        "label_shares": packing.pack_floats(description.label_shares),
    }
    connection.execute(inserting(DESCRIPTIONS), {**facts, "checksum": checksums.of_row(DESCRIPTIONS, facts)})
    parts = {
        VECTORS: packing.pack_vectors(description, recipe),
        APPEARANCES: packing.pack_appearance(description.appearance),
        CELLS: packing.pack_cells(description.cells),
    }
    if description.keypoints is not None:
        parts[KEYPOINTS] = packing.pack_keypoints(description.keypoints)
    for table, body in parts.items():
        checksum = checksums.of_body(job.seq, job.recipe, body)
        connection.execute(inserting(table), {**key, "body": body, "checksum": checksum})


class Descriptions(Part):
    """Descriptions as `worker.search.ports.DescriptionReader` reads them.

    Each body is compared with its checksum. A damaged description is absent like that of a deleted view, and is set
    aside before the call returns: see `worker.storage.damage`.
    """

    def since(self, name: str, revision: int, recipe: DescriptionRecipe | None = None) -> Changes:
        """Changes to a map's searchable views since a revision (0: all views); raises NotFound, Damaged.

        `recipe`: of the views described by this one, whether or not the map is searched by it. Where it is not, they
        are as of the clock's last revision.
        """
        with self._database.reading() as connection:
            row = find_map(connection, name)
            by: str = row.recipe if recipe is None else recipe.id
            # An index from before the last change of recipe has none of the present vectors: it needs all of them.
            known = int(revision) if recipe is not None or revision >= row.anew else -1
            as_of = int(row.revision) if by == row.recipe else clock.read(connection)
            described = (
                sa.select(DESCRIPTIONS.c.seq, VECTORS.c.body, VECTORS.c.checksum)
                .outerjoin(VECTORS, (VECTORS.c.seq == DESCRIPTIONS.c.seq) & (VECTORS.c.recipe == DESCRIPTIONS.c.recipe))
                .where(
                    DESCRIPTIONS.c.map_id == row.id,
                    DESCRIPTIONS.c.recipe == by,
                    DESCRIPTIONS.c.revision > known,
                )
            )
            size = vectors_size(find_recipe(connection, by) if recipe is None else recipe)
            of = by.encode()
            seqs: list[int] = []
            damaged: dict[int, str] = {}
            vectors = bytearray()
            for portion in connection.execution_options(yield_per=ROWS).execute(described).partitions():
                whole = [
                    (seq, body)
                    for seq, body, checksum in portion
                    # As `checksums.of_body`, without a call for each of the rows of a whole map.
                    if body is not None and len(body) == size and crc32(body, crc32(b"%d %b " % (seq, of))) == checksum
                ]
                if len(whole) < len(portion):
                    damaged |= dict.fromkeys({seq for seq, *_ in portion} - {seq for seq, _ in whole}, VECTORS.name)
                seqs.extend(seq for seq, _ in whole)
                vectors += b"".join([body for _, body in whole])
            left = sa.select(TOMBSTONES.c.seq).where(TOMBSTONES.c.map_id == row.id, TOMBSTONES.c.revision > revision)
            gone = list(connection.scalars(left.order_by(TOMBSTONES.c.seq)))
        numbers, rows = _in_order(
            np.array(seqs, np.int64), packing.unpack_floats(vectors).reshape(len(seqs), -1 if seqs else 0)
        )
        finite = np.isfinite(rows).all(axis=1)
        if not finite.all():
            damaged |= dict.fromkeys(numbers[~finite].tolist(), VECTORS.name)
            numbers, rows = numbers[finite], rows[finite]
        self._quarantine.descriptions(damaged, by)
        return Changes(as_of, by, numbers, rows, np.array(gone, np.int64))

    def described(self, name: str, recipe: str) -> Sequence64:
        """Sequence numbers of a map's views that a recipe describes, ascending; raises NotFound."""
        with self._database.reading() as connection:
            of = DESCRIPTIONS.c.map_id == find_map(connection, name).id, DESCRIPTIONS.c.recipe == recipe
            return np.array(sorted(connection.scalars(sa.select(DESCRIPTIONS.c.seq).where(*of))), np.int64)

    def count_described(self, name: str, recipe: str) -> int:
        """How many views of a map a recipe describes; raises NotFound."""
        with self._database.reading() as connection:
            of = DESCRIPTIONS.c.map_id == find_map(connection, name).id, DESCRIPTIONS.c.recipe == recipe
            return int(connection.scalar(sa.select(sa.func.count()).select_from(DESCRIPTIONS).where(*of)) or 0)

    def vectors(self, seqs: Sequence[int], recipe: str) -> dict[int, Floats]:
        """Histogram vectors, the channels concatenated, by sequence number; deleted views are absent."""
        return self._parts(VECTORS, seqs, recipe, packing.unpack_floats)

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        """Cells at half size, graphs and extents by sequence number; deleted views are absent."""
        return self._parts(APPEARANCES, seqs, recipe, _appearance)

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        """Cells at full resolution by sequence number; deleted views are absent."""
        return self._parts(CELLS, seqs, recipe, packing.unpack_cells)

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        """Local features by sequence number; deleted views are absent."""
        return self._parts(KEYPOINTS, seqs, recipe, packing.unpack_keypoints)

    def whole(self, seq: int, recipe: DescriptionRecipe) -> Description | None:
        """A view's whole description; None when it was deleted."""
        appearances, cells = self.appearances([seq], recipe.id), self.cells([seq], recipe.id)
        of = DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == recipe.id
        facts = sa.select(DESCRIPTIONS, VECTORS.c.body).join(
            VECTORS, (VECTORS.c.seq == DESCRIPTIONS.c.seq) & (VECTORS.c.recipe == DESCRIPTIONS.c.recipe)
        )
        with self._database.reading() as connection:
            row = connection.execute(facts.where(*of)).one_or_none()
            fault = None if row is None else description_fault(connection, seq, recipe.id)
        if fault is not None:
            self._quarantine.descriptions({seq: fault}, recipe.id)
            return None
        features = self.local_features([seq], recipe.id).get(seq)
        lacking = features is None and recipe.parameters.local_features is not None
        if row is None or lacking or seq not in appearances or seq not in cells:
            return None
        return Description(
            vectors=packing.unpack_vectors(row.body, recipe),
            appearance=appearances[seq],
            cells=cells[seq],
            keypoints=features,
            label_shares=packing.unpack_floats(row.label_shares),
            static_share=row.static_share,
            descriptor_count=row.descriptor_count,
        )

    def _parts(
        self, table: sa.Table, seqs: Sequence[int], recipe: str, unpack: Callable[..., Unpacked]
    ) -> dict[int, Unpacked]:
        """A part of descriptions by sequence number, from whole rows."""
        found: dict[int, Unpacked] = {}
        damaged: dict[int, str] = {}
        with self._database.reading() as connection:
            reading = _reading(table, connection.dialect.name)
            for portion in batches(int(seq) for seq in seqs):
                for seq, body, checksum, *size in connection.execute(reading, {"seqs": portion, "recipe": recipe}):
                    try:
                        if checksums.of_body(seq, recipe, body) != checksum:
                            raise ValueError("the body does not fit its checksum")
                        found[seq] = unpack(body, *size)
                    except ValueError:
                        damaged[seq] = table.name
        self._quarantine.descriptions(damaged, recipe)
        return found


@cache
def _reading(table: sa.Table, database: str) -> sa.Select[Any]:
    """Selects bodies by views and recipe, appearances with the sizes of their images.

    Cached, since building the statement takes as long as running it.
    """
    mine = dialect.one_of(table.c.seq, "seqs", database), table.c.recipe == sa.bindparam("recipe")
    bodies = sa.select(table.c.seq, table.c.body, table.c.checksum).where(*mine)
    if table is APPEARANCES:
        bodies = bodies.add_columns(VIEWS.c.width, VIEWS.c.height).join(VIEWS, VIEWS.c.seq == table.c.seq)
    return bodies.execution_options(**{dialect.AS_BYTES: True})


def _appearance(body: bytes, width: int, height: int) -> Appearance:
    """The appearance of a view by the size of its image; raises ValueError."""
    if not (isinstance(width, int) and isinstance(height, int) and width > 0 and height > 0):
        raise ValueError("the size of the image is damaged")
    return packing.unpack_appearance(body, extent_of(width, height))


def _in_order(seqs: Sequence64, vectors: Floats) -> tuple[Sequence64, Floats]:
    """Both sorted by seq; sorting in the database would move every vector."""
    if np.all(seqs[1:] > seqs[:-1]):
        return seqs, vectors
    order = np.argsort(seqs)
    return seqs[order], vectors[order]
