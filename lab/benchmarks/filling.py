"""A map of any size without enrolling that many images: real descriptions, many times, each a little different."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa
from uuid6 import uuid7

from schemas.description import Description
from schemas.recipe import DescriptionRecipe
from worker.storage import checksums, packing
from worker.storage.tables import APPEARANCES, CELLS, CLOCK, DESCRIPTIONS, KEYPOINTS, MAPS, VECTORS, VIEWS

NOISE = 0.5
"""Length of the random vector added to each unit-length histogram vector: different places, not copies."""

BLOCK = 1000


def fill(
    url: str, name: str, recipe: DescriptionRecipe, descriptions: Sequence[Description], count: int, seed: int = 0
) -> None:
    """Add `count` views to a map, past the queue and without image files.

    Parameters
    ----------
    url : str
        SQLAlchemy URL of a database that nothing else uses.
    name : str
        Of a map that exists.
    recipe : DescriptionRecipe
        The map's.
    descriptions : sequence of Description
        By that recipe; taken in turn.
    count : int
    seed : int
    """
    random = np.random.default_rng(seed)
    parts = [
        {
            APPEARANCES: packing.pack_appearance(d.appearance),
            CELLS: packing.pack_cells(d.cells),
            KEYPOINTS: b"" if d.keypoints is None else packing.pack_keypoints(d.keypoints),
            "shares": packing.pack_floats(d.label_shares),
        }
        for d in descriptions
    ]
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        row = connection.execute(sa.select(MAPS.c.id, MAPS.c.revision).where(MAPS.c.name == name)).one()
        revision = row.revision + 1
        first = (connection.scalar(sa.select(sa.func.max(VIEWS.c.seq))) or 0) + 1
        for start in range(0, count, BLOCK):
            seqs = range(first + start, first + min(start + BLOCK, count))
            picks = [seq % len(descriptions) for seq in seqs]
            _insert(connection, VIEWS, [_view(seq, row.id) for seq in seqs])
            _insert(
                connection,
                DESCRIPTIONS,
                [
                    {
                        "seq": seq, "recipe": recipe.id, "map_id": row.id, "revision": revision,
                        "descriptor_count": descriptions[pick].descriptor_count,
                        "static_share": descriptions[pick].static_share,
                        "nodes": len(descriptions[pick].appearance.graph), "label_shares": parts[pick]["shares"],
                    }
                    for seq, pick in zip(seqs, picks, strict=True)
                ],
            )  # fmt: skip
            bodies: dict[sa.Table, list[bytes]] = {
                VECTORS: [_vectors(descriptions[pick], recipe, random) for pick in picks],
                APPEARANCES: [parts[pick][APPEARANCES] for pick in picks],
                CELLS: [parts[pick][CELLS] for pick in picks],
            }
            if recipe.parameters.local_features is not None:
                bodies[KEYPOINTS] = [parts[pick][KEYPOINTS] for pick in picks]
            for table, column in bodies.items():
                rows = [
                    {"seq": s, "recipe": recipe.id, "body": b, "checksum": checksums.of_body(s, recipe.id, b)}
                    for s, b in zip(seqs, column, strict=True)
                ]
                connection.execute(sa.insert(table), rows)
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(revision=revision))
        ahead = max(int(connection.scalar(sa.select(CLOCK.c.revision)) or 0), revision)
        connection.execute(sa.update(CLOCK).values(revision=ahead))
    engine.dispose()


def _insert(connection: sa.Connection, table: sa.Table, rows: Sequence[dict[str, Any]]) -> None:
    """Insert rows with their checksums."""
    connection.execute(sa.insert(table), [{**row, "checksum": checksums.of_row(table, row)} for row in rows])


def _view(seq: int, map_id: int) -> dict[str, Any]:
    return {
        "seq": seq, "id": str(uuid7()), "map_id": map_id, "place": f"place {seq}", "x": float(seq), "y": 0.0,
        "metadata": "{}", "enrolled_at": datetime.now(UTC), "sha256": f"{seq:064x}", "width": 640, "height": 480,
        "byte_count": 100_000, "format": "jpeg", "state": "ready", "elapsed_us": seq,
    }  # fmt: skip


def _vectors(description: Description, recipe: DescriptionRecipe, random: np.random.Generator) -> bytes:
    mixed = []
    for channel in recipe.parameters.channels:
        vector = description.vectors[channel]
        noise = random.standard_normal(len(vector)).astype(np.float32)
        moved = vector + NOISE * noise / np.linalg.norm(noise)
        mixed.append(packing.pack_floats(moved / np.linalg.norm(moved)))
    return b"".join(mixed)
