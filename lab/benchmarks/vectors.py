"""What a search costs in memory and in PostgreSQL by pgvector, exactly and by HNSW, and what HNSW misses.

    ./revisit benchmark vectors --database postgresql://user@host/empty [--views 1000 10000 100000] [--queries 40]

The database is one for this alone: maps are made in it and deleted again. Vectors are drawn: two channels of 128
dimensions that vary in `INNER` directions and a little in all others, of unit length, as histograms do. The three are
queried in turn with the same vectors, so that they share whatever else the machine does; ratios are of medians.
"""

import argparse
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import sqlalchemy as sa

from schemas.description import Floats
from schemas.recipe import Channel, DescriptionParameters, DescriptionRecipe, MapRecipe, RankingConfig
from schemas.records import Candidates, Filters
from worker.search.choosing import Kind, make_catalogue
from worker.storage import checksums, clock, packing
from worker.storage.store import SqlStore, open_store
from worker.storage.tables import DESCRIPTIONS, MAPS, VECTORS, VIEWS

KINDS: tuple[Kind, ...] = ("faiss", "pgvector", "pgvector-hnsw")
INNER = 24
NOISE = 0.05
BLOCK = 2000
COUNT = 50
"""Candidates of each channel, as in the default preset."""

CHANNELS = ("semantic", "detail")
RECIPE = MapRecipe(
    description=DescriptionRecipe(
        encoder="color",
        weights="0" * 64,
        labels=("wall", "car"),
        dynamic=("car",),
        parameters=DescriptionParameters(
            channels={name: Channel(layer=name, vocabulary_size=128) for name in CHANNELS}, seed=0, local_features=None
        ),
        vocabulary="0" * 64,
    ),
    ranking=RankingConfig(),
)


def main(given: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="revisit benchmark vectors", description="Time searches in memory and in PostgreSQL."
    )
    parser.add_argument("--database", required=True, help="SQLAlchemy URL of an empty PostgreSQL database")
    parser.add_argument("--views", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--queries", type=int, default=40)
    arguments = parser.parse_args(given)
    with TemporaryDirectory() as folder:
        stores = {kind: open_store(arguments.database, Path(folder) / kind, index=kind) for kind in KINDS}
        for store in stores.values():
            with closing(store):
                store.check()
        print(f"{datetime.now(UTC):%Y-%m-%d}, {_versions(arguments.database)}")
        print("views  search           ms   over memory  recall@50  first query s  built s  rows MB")
        for views in arguments.views:
            _measure(arguments.database, Path(folder), views, arguments.queries)


def _versions(url: str) -> str:
    engine = sa.create_engine(sa.make_url(url).set(drivername="postgresql+psycopg"))
    with engine.connect() as connection:
        server = connection.scalar(sa.text("SHOW server_version"))
        extension = connection.scalar(sa.text("SELECT extversion FROM pg_extension WHERE extname = 'vector'"))
        memory = connection.scalar(sa.text("SHOW shared_buffers"))
    engine.dispose()
    own = f"faiss-cpu {version('faiss-cpu')}, numpy {np.__version__}, Python {platform.python_version()}"
    return f"PostgreSQL {server} (shared_buffers {memory}), pgvector {extension}, {own}"


def _measure(url: str, folder: Path, views: int, queries: int) -> None:
    draw = np.random.default_rng(views)
    inner = draw.standard_normal((len(CHANNELS), INNER, 128)).astype(np.float32)
    opened = {kind: open_store(url, folder / kind, index=kind) for kind in KINDS}
    name = f"drawn-{views}"
    try:
        _fill(opened["faiss"], name, views, inner, draw)
        searches, first, built = {}, {}, float("nan")
        for kind in KINDS:
            searches[kind] = _search_of(opened[kind], name, kind)
            first[kind] = _seconds(partial(searches[kind], _query(inner, draw)))
        indexing = opened["pgvector-hnsw"].indexing
        assert indexing is not None
        built = _seconds(indexing.step)
        took: dict[str, list[float]] = {kind: [] for kind in KINDS}
        found: dict[str, list[Candidates]] = {kind: [] for kind in KINDS}
        for query in [_query(inner, draw) for _ in range(queries)]:
            for kind in KINDS:
                began = time.perf_counter()
                found[kind].append(searches[kind](query))
                took[kind].append(1000 * (time.perf_counter() - began))
        for kind in KINDS:
            pairs = zip(found[kind], found["faiss"], strict=True)
            recall = float(np.mean([_recall(one, exact) for one, exact in pairs]))
            times = float(np.median(took[kind])), float(np.median(took[kind]) / np.median(took["faiss"]))
            size = "" if kind == "faiss" else f"{_size(opened[kind]) / 1e6:8.0f}"
            took_built = f"{built:8.1f}" if kind == "pgvector-hnsw" else " " * 8
            line = f"{views:6d} {kind:14} {times[0]:7.2f} {times[1]:12.1f} {recall:10.4f} {first[kind]:14.2f}"
            print(f"{line} {took_built} {size}".rstrip(), flush=True)
    finally:
        opened["faiss"].removals.delete_map(name)
        for store in opened.values():
            store.close()


def _search_of(store: SqlStore, name: str, kind: Kind) -> Callable[[Mapping[str, Floats]], Candidates]:
    catalogue, selecting = make_catalogue(store, kind)

    def search(query: Mapping[str, Floats]) -> Candidates:
        index, _ = catalogue.index(name)
        return index.search(query, COUNT, selecting.select(name, Filters()))

    return search


def _fill(store: SqlStore, name: str, views: int, inner: Floats, draw: np.random.Generator) -> None:
    """Add a map and its views past the queue, with no more of their descriptions than a search reads."""
    store.maps.put(name, RECIPE, datetime.now(UTC))
    recipe = RECIPE.description.id
    for start in range(0, views, BLOCK):
        count = min(BLOCK, views - start)
        bodies = [packing.pack_floats(row) for row in np.concatenate(_drawn(inner, draw, count), axis=1)]
        with store.maps._database.writing() as connection:
            map_id = int(connection.scalar(sa.select(MAPS.c.id).where(MAPS.c.name == name)) or 0)
            revision = clock.tick(connection, map_id)
            first = (connection.scalar(sa.select(sa.func.max(VIEWS.c.seq))) or 0) + 1
            seqs = range(first, first + count)
            connection.execute(
                sa.insert(VIEWS),
                [
                    {
                        "seq": seq, "id": f"{name}-{seq}", "map_id": map_id, "place": f"place {seq}", "x": float(seq),
                        "y": 0.0, "metadata": "{}", "enrolled_at": datetime.now(UTC), "sha256": f"{seq:064x}",
                        "width": 640, "height": 480, "byte_count": 1, "format": "jpeg", "state": "ready",
                    }
                    for seq in seqs
                ],
            )  # fmt: skip
            facts = {"recipe": recipe, "map_id": map_id, "revision": revision, "descriptor_count": 1, "nodes": 0}
            rows = [{**facts, "seq": seq, "static_share": 1.0, "label_shares": b""} for seq in seqs]
            connection.execute(sa.insert(DESCRIPTIONS), rows)
            connection.execute(
                sa.insert(VECTORS),
                [
                    {"seq": s, "recipe": recipe, "body": body, "checksum": checksums.of_body(s, recipe, body)}
                    for s, body in zip(seqs, bodies, strict=True)
                ],
            )


def _drawn(inner: Floats, draw: np.random.Generator, count: int) -> list[Floats]:
    """Unit vectors of each channel, float32 (count, 128)."""
    made = []
    for directions in inner:
        rows = draw.standard_normal((count, INNER)).astype(np.float32) @ directions / INNER**0.5
        rows += NOISE * draw.standard_normal(rows.shape).astype(np.float32)
        made.append((rows / np.linalg.norm(rows, axis=1, keepdims=True)).astype(np.float32))
    return made


def _query(inner: Floats, draw: np.random.Generator) -> dict[str, Floats]:
    return {name: rows[0] for name, rows in zip(CHANNELS, _drawn(inner, draw, 1), strict=True)}


def _recall(found: Candidates, exact: Candidates) -> float:
    """Share of the exact candidates of each channel that were found."""
    shares = []
    for channel in CHANNELS:
        right = set(exact.seqs[exact.ranks[channel] > 0].tolist())
        shares.append(len(right & set(found.seqs[found.ranks[channel] > 0].tolist())) / len(right))
    return float(np.mean(shares))


def _size(store: SqlStore) -> int:
    with store.maps._database.reading() as connection:
        return int(connection.scalar(sa.text("SELECT pg_total_relation_size('searched_vectors')")) or 0)


def _seconds(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
