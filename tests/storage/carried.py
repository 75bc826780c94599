"""A map with everything that a snapshot holds, and how two such maps are compared."""

import json
from pathlib import Path

import sqlalchemy as sa

from schemas.comparisons import Comparison
from schemas.records import Filters, Position, ViewAttributes, ViewRecord
from schemas.snapshot import SnapshotRecord
from tests.storage.material import NOW, RECIPE, Follower, describe_all, enroll
from worker.storage.store import SqlStore

JOB = "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90"


def quiet(done: int, total: int) -> None: ...


def filled(store: SqlStore, count: int = 3) -> None:
    """The map ``campus``: described views with attributes and comparisons, one failed, one pending; another map."""
    for number in range(count):
        said = ViewAttributes(
            f"place {number}", Position(x=number / 3, y=1e-9), NOW, {"floor": number, "n": {"é": [1]}}
        )
        enroll(store, f"view {number}", attributes=said)
        enroll(store, f"view {number}", map="other")
    describe_all(store)
    seqs = [view.seq for view in views(store)]
    compared = [
        Comparison(seq, 0.25, 0.125, (seqs[0], seqs[-1]), count, count - 1, seqs[0], 0.5 + at / 8, 0.75 - at / 8)
        for at, seq in enumerate(seqs)
    ]
    store.comparisons.keep("campus", RECIPE, compared, NOW)
    enroll(store, "broken")
    for claim in store.jobs.claim("worker", 10):
        store.jobs.fail(claim, "nothing-static", "sky", NOW)
    enroll(store, "waits")
    store.maps.set_calibration("campus", '{"a": 1}')


def views(store: SqlStore, name: str = "campus") -> list[ViewRecord]:
    return store.views.list(name, Filters(), limit=500)[0]


def made(store: SqlStore, name: str = "campus") -> Path:
    """The file of a new snapshot."""
    record: SnapshotRecord = store.snapshots.make(name, JOB, NOW, quiet)
    with store.snapshots.open(record.facts.id) as file:
        return Path(file.name)


def contents(store: SqlStore, name: str = "campus") -> list[object]:
    """All that answers are made of, without what is the database's own: sequence numbers and revisions."""
    record = store.maps.get(name)
    listed = views(store, name)
    number = {view.seq: at for at, view in enumerate(listed)}
    vectors = {number[seq]: vector for seq, vector in Follower(store, name).catch_up().vectors.items()}
    with store._database.reading() as connection:
        comparisons = [
            (
                number[row.seq],
                row.level,
                row.gap,
                row.among,
                row.others,
                row.rival and number.get(row.rival),
                row.own,
                row.breadth,
                sorted(number[s] for s in json.loads(row.same_spot)),
            )
            for row in connection.execute(sa.text("SELECT * FROM comparisons ORDER BY seq"))
            if row.seq in number
        ]
        bodies = [
            [
                (number[row.seq], bytes(row.body))
                for row in connection.execute(sa.text(f"SELECT seq, body FROM {table} ORDER BY seq"))
                if row.seq in number
            ]
            for table in ("appearances", "cells", "keypoints")
        ]
    facts = [
        (
            v.attributes,
            v.image,
            v.state,
            v.failure,
            v.enrolled_at,
            v.description and v.description.nodes,
            store.views.image(v.id),
        )
        for v in listed
    ]
    return [
        record.description,
        record.ranking,
        record.calibration,
        record.created_at,
        facts,
        vectors,
        comparisons,
        bodies,
    ]
