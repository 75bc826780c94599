"""A map of any size without enrolling that many images: real descriptions, many times, each a little different."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import sqlalchemy as sa
from uuid6 import uuid7

from schemas.description import Description
from schemas.recipe import DescriptionRecipe
from worker.storage import checksums, packing
from worker.storage.filtering import metadata_pairs
from worker.storage.rows import keep_recipe
from worker.storage.tables import (
    APPEARANCES,
    CELLS,
    CLOCK,
    DESCRIPTIONS,
    KEYPOINTS,
    MAPS,
    METADATA_PAIRS,
    VECTORS,
    VIEWS,
)

NOISE = 0.5
"""Length of the random vector added to each unit-length histogram vector: different places, not copies."""

BLOCK = 1000

RUNS = 10
"""Values of `metadata.run`, of which the views have one each in turn."""

EPOCH = datetime(2026, 3, 1, tzinfo=UTC)
"""Views are captured a second after one another, from then on."""

Keep = Callable[[Mapping[str, bytes]], None]
"""Stores images by their digests."""


def fill(
    url: str,
    name: str,
    recipe: DescriptionRecipe,
    descriptions: Sequence[Description],
    count: int,
    seed: int = 0,
    keep: Keep | None = None,
    image_bytes: int = 100_000,
) -> None:
    """Add `count` views to a map, past the queue.

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
    keep : function or None
        Stores what stands for the images; None: there are none.
    image_bytes : int
        Of each image.
    """
    random = np.random.default_rng(seed)
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        row = connection.execute(sa.select(MAPS.c.id, MAPS.c.revision).where(MAPS.c.name == name)).one()
        revision = row.revision + 1
        first = (connection.scalar(sa.select(sa.func.max(VIEWS.c.seq))) or 0) + 1
        for start in range(0, count, BLOCK):
            seqs = range(first + start, first + min(start + BLOCK, count))
            digests = [f"{seq:064x}" for seq in seqs] if keep is None else _kept(keep, random, len(seqs), image_bytes)
            views = [_view(seq, row.id, digest, image_bytes) for seq, digest in zip(seqs, digests, strict=True)]
            _insert(connection, VIEWS, views)
            pairs = [{"pair": pair, "seq": seq} for seq in seqs for pair in metadata_pairs(_metadata(seq))]
            connection.execute(sa.insert(METADATA_PAIRS), pairs)
            _describe(connection, row.id, recipe, descriptions, seqs, revision, random)
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(revision=revision))
        ahead = max(int(connection.scalar(sa.select(CLOCK.c.revision)) or 0), revision)
        connection.execute(sa.update(CLOCK).values(revision=ahead))
    engine.dispose()


def describe_anew(
    url: str, name: str, recipe: DescriptionRecipe, descriptions: Sequence[Description], seed: int = 0
) -> None:
    """Add descriptions by another recipe to all views of a map that lack them: it can change over at once.

    Parameters are those of `fill`.
    """
    random = np.random.default_rng(seed)
    engine = sa.create_engine(url)
    with engine.begin() as connection:
        row = connection.execute(sa.select(MAPS.c.id, MAPS.c.revision).where(MAPS.c.name == name)).one()
        keep_recipe(connection, recipe)
        # As if it were the way back: descriptions of no recipe of the map are pruned.
        changed = {"previous_recipe": recipe.id, "checksum": None}
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(**changed))
        there = sa.exists().where(DESCRIPTIONS.c.seq == VIEWS.c.seq, DESCRIPTIONS.c.recipe == recipe.id)
        lacking = sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == row.id, ~there).order_by(VIEWS.c.seq)
        seqs = list(connection.scalars(lacking))
        for start in range(0, len(seqs), BLOCK):
            some = seqs[start : start + BLOCK]
            _describe(connection, row.id, recipe, descriptions, some, row.revision, random)
    engine.dispose()


def _describe(
    connection: sa.Connection,
    map_id: int,
    recipe: DescriptionRecipe,
    descriptions: Sequence[Description],
    seqs: Sequence[int],
    revision: int,
    random: np.random.Generator,
) -> None:
    """Insert descriptions of views."""
    picks = [descriptions[seq % len(descriptions)] for seq in seqs]
    _insert(
        connection,
        DESCRIPTIONS,
        [
            {
                "seq": seq, "recipe": recipe.id, "map_id": map_id, "revision": revision,
                "descriptor_count": pick.descriptor_count, "static_share": pick.static_share,
                "nodes": len(pick.appearance.graph), "label_shares": packing.pack_floats(pick.label_shares),
            }
            for seq, pick in zip(seqs, picks, strict=True)
        ],
    )  # fmt: skip
    bodies: dict[sa.Table, list[bytes]] = {
        VECTORS: [_vectors(pick, recipe, random) for pick in picks],
        APPEARANCES: [packing.pack_appearance(pick.appearance) for pick in picks],
        CELLS: [packing.pack_cells(pick.cells) for pick in picks],
    }
    if recipe.parameters.local_features is not None:
        bodies[KEYPOINTS] = [b"" if d.keypoints is None else packing.pack_keypoints(d.keypoints) for d in picks]
    for table, column in bodies.items():
        rows = [
            {"seq": s, "recipe": recipe.id, "body": b, "checksum": checksums.of_body(s, recipe.id, b)}
            for s, b in zip(seqs, column, strict=True)
        ]
        connection.execute(sa.insert(table), rows)


def _kept(keep: Keep, random: np.random.Generator, count: int, size: int) -> list[str]:
    """Store so many images of random bytes; returns their digests."""
    images = [random.bytes(size) for _ in range(count)]
    digests = [hashlib.sha256(image).hexdigest() for image in images]
    keep(dict(zip(digests, images, strict=True)))
    return digests


def _insert(connection: sa.Connection, table: sa.Table, rows: Sequence[dict[str, Any]]) -> None:
    """Insert rows with their checksums."""
    connection.execute(sa.insert(table), [{**row, "checksum": checksums.of_row(table, row)} for row in rows])


def _metadata(seq: int) -> dict[str, Any]:
    return {"run": seq % RUNS}


def _view(seq: int, map_id: int, digest: str, image_bytes: int) -> dict[str, Any]:
    return {
        "seq": seq, "id": str(uuid7()), "map_id": map_id, "place": f"place {seq}", "x": float(seq), "y": 0.0,
        "heading": 90.0, "captured_at": EPOCH + timedelta(seconds=seq), "metadata": json.dumps(_metadata(seq)),
        "enrolled_at": datetime.now(UTC), "sha256": digest, "width": 640, "height": 480,
        "byte_count": image_bytes, "format": "jpeg", "state": "ready", "elapsed_us": seq,
    }  # fmt: skip


def _vectors(description: Description, recipe: DescriptionRecipe, random: np.random.Generator) -> bytes:
    mixed = []
    for channel in recipe.parameters.channels:
        vector = description.vectors[channel]
        noise = random.standard_normal(len(vector)).astype(np.float32)
        moved = vector + NOISE * noise / np.linalg.norm(noise)
        mixed.append(packing.pack_floats(moved / np.linalg.norm(moved)))
    return b"".join(mixed)
