"""Descriptions: written whole, read in the parts that an index and a ranking need."""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.description import Appearance, Description, Floats, Int8s, LocalFeatures
from schemas.image import extent_of
from schemas.recipe import DescriptionRecipe
from schemas.records import Changes, Sequence64
from worker.storage import packing
from worker.storage.part import Part
from worker.storage.rows import batches, find_map, inserting
from worker.storage.tables import APPEARANCES, CELLS, DESCRIPTIONS, KEYPOINTS, TOMBSTONES, VECTORS, VIEWS

ROWS = 4096
"""Descriptions read at a time."""


def keep_description(
    connection: sa.Connection, job: sa.Row[Any], recipe: DescriptionRecipe, description: Description, revision: int
) -> None:
    """Store the description of a job's view, as of a revision of the map."""
    key = {"seq": job.seq, "recipe": job.recipe}
    connection.execute(
        inserting(DESCRIPTIONS),
        {
            **key,
            "map_id": job.map_id,
            "revision": revision,
            "descriptor_count": int(description.descriptor_count),
            "static_share": float(description.static_share),
            "nodes": len(description.appearance.graph),
            "label_shares": packing.pack_floats(description.label_shares),
        },
    )
    parts = {
        VECTORS: packing.pack_vectors(description, recipe),
        APPEARANCES: packing.pack_appearance(description.appearance),
        CELLS: packing.pack_cells(description.cells),
    }
    if description.keypoints is not None:
        parts[KEYPOINTS] = packing.pack_keypoints(description.keypoints)
    for table, body in parts.items():
        connection.execute(inserting(table), {**key, "body": body})


class Descriptions(Part):
    """Descriptions as `worker.search.ports.DescriptionReader` reads them."""

    def since(self, name: str, revision: int) -> Changes:
        """Changes to a map's searchable views since a revision (0: all views); raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            # An index from before the last change of recipe has none of the present vectors: it needs all of them.
            known = int(revision) if revision >= row.anew else -1
            described = (
                sa.select(DESCRIPTIONS.c.seq, VECTORS.c.body)
                .join(VECTORS, (VECTORS.c.seq == DESCRIPTIONS.c.seq) & (VECTORS.c.recipe == DESCRIPTIONS.c.recipe))
                .where(
                    DESCRIPTIONS.c.map_id == row.id,
                    DESCRIPTIONS.c.recipe == row.recipe,
                    DESCRIPTIONS.c.revision > known,
                )
            )
            seqs: list[int] = []
            vectors = bytearray()
            for portion in connection.execution_options(yield_per=ROWS).execute(described).partitions():
                seqs.extend(seq for seq, _ in portion)
                vectors += b"".join([body for _, body in portion])
            left = sa.select(TOMBSTONES.c.seq).where(TOMBSTONES.c.map_id == row.id, TOMBSTONES.c.revision > revision)
            gone = list(connection.scalars(left.order_by(TOMBSTONES.c.seq)))
        numbers, rows = _in_order(
            np.array(seqs, np.int64), packing.unpack_floats(vectors).reshape(len(seqs), -1 if seqs else 0)
        )
        return Changes(row.revision, row.recipe, numbers, rows, np.array(gone, np.int64))

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        """Cells at half size, graphs and extents by sequence number; deleted views are absent."""
        return {
            seq: packing.unpack_appearance(body, extent_of(width, height))
            for seq, body, width, height in self._rows(_appearances(), seqs, recipe)
        }

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        """Cells at full resolution by sequence number; deleted views are absent."""
        return {seq: packing.unpack_cells(body) for seq, body in self._rows(_bodies(CELLS), seqs, recipe)}

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        """Local features by sequence number; deleted views are absent."""
        return {seq: packing.unpack_keypoints(body) for seq, body in self._rows(_bodies(KEYPOINTS), seqs, recipe)}

    def whole(self, seq: int, recipe: DescriptionRecipe) -> Description | None:
        """A view's whole description; None when it was deleted."""
        appearances, cells = self.appearances([seq], recipe.id), self.cells([seq], recipe.id)
        of = DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == recipe.id
        facts = sa.select(DESCRIPTIONS, VECTORS.c.body).join(
            VECTORS, (VECTORS.c.seq == DESCRIPTIONS.c.seq) & (VECTORS.c.recipe == DESCRIPTIONS.c.recipe)
        )
        with self._database.reading() as connection:
            row = connection.execute(facts.where(*of)).one_or_none()
        if row is None or seq not in appearances or seq not in cells:
            return None
        return Description(
            vectors=packing.unpack_vectors(row.body, recipe),
            appearance=appearances[seq],
            cells=cells[seq],
            keypoints=self.local_features([seq], recipe.id).get(seq),
            label_shares=packing.unpack_floats(row.label_shares),
            static_share=row.static_share,
            descriptor_count=row.descriptor_count,
        )

    def _rows(self, reading: sa.Select[Any], seqs: Sequence[int], recipe: str) -> list[Any]:
        with self._database.reading() as connection:
            return [
                row
                for portion in batches(int(seq) for seq in seqs)
                for row in connection.execute(reading, {"seqs": portion, "recipe": recipe})
            ]


@cache
def _bodies(table: sa.Table) -> sa.Select[Any]:
    """Selects bodies by views and recipe; cached, since building the statement takes as long as running it."""
    seqs: sa.BindParameter[Any] = sa.bindparam("seqs", expanding=True)
    recipe: sa.BindParameter[Any] = sa.bindparam("recipe")
    return sa.select(table.c.seq, table.c.body).where(table.c.seq.in_(seqs), table.c.recipe == recipe)


@cache
def _appearances() -> sa.Select[Any]:
    """Selects appearances and image sizes by views and recipe."""
    reading = _bodies(APPEARANCES).add_columns(VIEWS.c.width, VIEWS.c.height)
    return reading.join(VIEWS, VIEWS.c.seq == APPEARANCES.c.seq)


def _in_order(seqs: Sequence64, vectors: Floats) -> tuple[Sequence64, Floats]:
    """Both sorted by seq; sorting in the database would move every vector."""
    if np.all(seqs[1:] > seqs[:-1]):
        return seqs, vectors
    order = np.argsort(seqs)
    return seqs[order], vectors[order]
