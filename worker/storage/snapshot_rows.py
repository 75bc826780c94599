"""Conversion between rows and the lines of a snapshot; damaged rows never get into one."""

import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from functools import cache
from itertools import chain
from typing import Any, NamedTuple

import sqlalchemy as sa
from pydantic import ValidationError
from pydantic_core import to_json

from schemas.errors import BadSnapshot, Damaged
from schemas.image import ImageFacts
from schemas.recipe import DescriptionRecipe
from schemas.records import Position, ViewAttributes
from schemas.snapshot import SnapshotComparison, SnapshotDescription, SnapshotFacts, SnapshotLine, SnapshotView
from worker.storage import checksums, packing
from worker.storage.damage import vectors_fault
from worker.storage.rows import COORDINATES, has_whole_attributes
from worker.storage.snapshot_files import Part
from worker.storage.tables import APPEARANCES, CELLS, COMPARISONS, DESCRIPTIONS, KEYPOINTS, VECTORS, VIEWS

PARTS = {"vectors": VECTORS, "appearances": APPEARANCES, "cells": CELLS, "keypoints": KEYPOINTS}

BODIES = ("label_shares", *PARTS)
"""Bodies of a description, in the order in which a snapshot has them."""

DAMAGED_VIEW = (
    "the attributes of the view {} are damaged, so that no whole snapshot can be made; enrol its image again with its "
    "attributes, or delete it"
)


class WrittenView(NamedTuple):
    """A view as it goes into a snapshot: its id, its image by SHA-256, its line, and the bodies of its description."""

    id: str
    digest: str
    line: bytes
    bodies: tuple[bytes, ...]


def first_elapsed(connection: sa.Connection, map_id: int) -> int:
    """The elapsed time (microseconds) from which a snapshot counts: 0, or that of the map's first view if negative.

    Restored views may have negative elapsed times (see `restoring.py`); snapshots have none.
    """
    least = connection.scalar(sa.select(sa.func.min(VIEWS.c.elapsed_us)).where(VIEWS.c.map_id == map_id))
    return min(0, int(least or 0))


def written_views(
    connection: sa.Connection, seqs: Sequence[int], recipe: DescriptionRecipe, since_us: int
) -> list[WrittenView]:
    """Views in enrolment order, their elapsed times counted from `since_us`; raises Damaged for attributes that are.

    A view whose description is missing or damaged goes without: where it is restored, it is described from its image.
    """
    of = recipe.id  # a hash of all of it, made anew each time it is read
    rows = connection.execute(_rows(), {"seqs": seqs, "recipe": of}).all()
    names = tuple(_rows().selected_columns.keys())
    knowns = [dict(zip(names, row, strict=True)) for row in rows]  # many times as quick as a column at a time
    return [
        _written(row, known, _described(known, recipe, of), since_us) for row, known in zip(rows, knowns, strict=True)
    ]


def comparison_lines(
    connection: sa.Connection, map_id: int, recipe: str, left_out: set[int], count: int
) -> Iterator[list[bytes]]:
    """Portions of the lines of a map's whole comparisons, views in `left_out` excepted."""
    mine = COMPARISONS.c.map_id == map_id, COMPARISONS.c.recipe == recipe
    rows = connection.execution_options(yield_per=count).execute(
        sa.select(COMPARISONS).where(*mine).order_by(COMPARISONS.c.seq)
    )
    for portion in rows.partitions(count):
        yield [
            SnapshotComparison(
                number=row.seq,
                among=row.among,
                others=row.others,
                level=row.level,
                gap=row.gap,
                same_spot=tuple(seq for seq in json.loads(row.same_spot) if seq not in left_out),
                made_at=row.made_at,
                rival=row.rival,
                own=row.own,
                breadth=row.breadth,
            )
            .model_dump_json()
            .encode()
            + b"\n"
            for row in portion
            if row.seq not in left_out and checksums.is_whole(COMPARISONS, row)
        ]


def _written(row: sa.Row[Any], known: Mapping[str, Any], described: "_Described | None", since_us: int) -> WrittenView:
    if not has_whole_attributes(row):
        raise Damaged(DAMAGED_VIEW.format(row.id))
    ready, failed = known["state"] == "ready" and described is not None, known["state"] == "failed"
    view = {
        "number": known["seq"],
        **{name: known[name] for name in ("id", "place", *COORDINATES)},
        "captured_at": _moment(known["captured_at"]),
        "metadata": json.loads(known["metadata"]),
        "filename": known["filename"],
        "enrolled_at": _moment(known["enrolled_at"]),
        "elapsed_us": known["elapsed_us"] - since_us,
        **{name: known[name] for name in ("sha256", "sent_sha256", "width", "height", "byte_count", "format")},
        "state": "ready" if ready else "failed" if failed else "pending",
        "failure_code": known["failure_code"] if failed else None,
        "failure_detail": known["failure_detail"] if failed else None,
        "description": None,
    }
    bodies: tuple[bytes, ...] = ()
    if described is not None and ready:
        sizes = {name: len(described.bodies[name]) if name in described.bodies else None for name in BODIES}
        view["description"] = described.facts | sizes
        bodies = tuple(described.bodies[name] for name in BODIES if name in described.bodies)
    return WrittenView(known["id"], known["sha256"], to_json(view) + b"\n", bodies)


def _moment(value: datetime | None) -> str | None:
    return None if value is None else value.isoformat()


class _Described(NamedTuple):
    """A description: what a line says of it, and its bodies by their names."""

    facts: dict[str, Any]
    bodies: dict[str, bytes]


def _described(known: Mapping[str, Any], recipe: DescriptionRecipe, of: str) -> _Described | None:
    """The description in a row of `_rows` by a recipe with the id `of`; None unless all of it is there and whole."""
    if known["described_seq"] is None or not checksums.is_whole_labelled(DESCRIPTIONS, known, "described"):
        return None
    bodies = {"label_shares": known["described_label_shares"]}
    for name in PARTS:
        body = known[name]
        if body is None and name == "keypoints" and recipe.parameters.local_features is None:
            continue
        if body is None or checksums.of_body(known["seq"], of, body) != known[f"{name}_checksum"]:
            return None
        bodies[name] = body
    facts = {name: known[f"described_{name}"] for name in ("descriptor_count", "static_share", "nodes")}
    return _Described(facts, bodies)


@cache
def _rows() -> sa.Select[Any]:
    """Views of the sequence numbers in ``seqs``, in enrolment order, with their descriptions by ``recipe``.

    One statement: each more costs as much as the reading itself.
    """
    joined: sa.FromClause = VIEWS
    for table in (DESCRIPTIONS, *PARTS.values()):
        mine = table.c.seq == VIEWS.c.seq, table.c.recipe == sa.bindparam("recipe")
        joined = joined.outerjoin(table, sa.and_(*mine))
    described = checksums.labelled(DESCRIPTIONS, "described")
    bodies = [(table.c.body.label(name), table.c.checksum.label(f"{name}_checksum")) for name, table in PARTS.items()]
    wanted = sa.select(*VIEWS.c, *described, *chain(*bodies)).select_from(joined)
    return wanted.where(VIEWS.c.seq.in_(sa.bindparam("seqs", expanding=True))).order_by(VIEWS.c.seq)


def read_views(part: Part, facts: SnapshotFacts) -> list[SnapshotView]:
    """The views of a part; raises BadSnapshot for anything that could not be stored."""
    views, end = [], 0
    for number, line in enumerate(part.body.splitlines(), 1):
        where = f"line {number} of its part {part.name}"
        if facts.version == 1:
            view: SnapshotView = _checked(SnapshotView, where, line)
        else:
            view, end = _joined(_checked(SnapshotLine, where, line), part.bodies, end)
        if (view.description is not None) != (view.state == "ready"):
            raise BadSnapshot(
                f"the view {view.id} is {view.state} and has {'a' if view.description else 'no'} description"
            )
        if view.description is not None:
            try:
                _check_description(view.description, facts.description)
            except ValueError as error:
                raise BadSnapshot(f"the description of the view {view.id} cannot be used: {error}") from None
        views.append(view)
    if end != len(part.bodies):
        raise BadSnapshot(f"the views of its part {part.name} have not all that the descriptions before it have")
    return views


def _joined(line: SnapshotLine, bodies: bytes, begin: int) -> tuple[SnapshotView, int]:
    """A view with its description, whose bodies begin there; and where they end."""
    description = None
    if line.description is not None:
        facts = dict(line.description)
        for name in BODIES:
            if (size := facts[name]) is not None:
                facts[name], begin = bodies[begin : begin + size], begin + size
        description = SnapshotDescription.model_construct(**facts)
    return SnapshotView.model_construct(**dict(line) | {"description": description}), begin


def read_comparisons(name: str, body: bytes) -> list[SnapshotComparison]:
    """The comparisons of a part; raises BadSnapshot."""
    lines = enumerate(body.splitlines(), 1)
    return [_checked(SnapshotComparison, f"line {number} of its part {name}", line) for number, line in lines]


def _checked(model: Any, what: str, line: bytes) -> Any:
    try:
        return model.model_validate_json(line)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "it"
        raise BadSnapshot(f"{what} cannot be used: {where}: {first['msg']}") from None


def _check_description(description: SnapshotDescription, recipe: DescriptionRecipe) -> None:
    """Raises ValueError for a description that is none by the recipe."""
    vectors_fault(description.vectors, recipe)
    packing.unpack_appearance(description.appearances, (1.0, 1.0))
    packing.unpack_cells(description.cells)
    if len(description.label_shares) != 4 * len(recipe.labels):
        raise ValueError(f"it has other than {len(recipe.labels)} shares of labels")
    if description.keypoints is not None:
        packing.unpack_keypoints(description.keypoints)
    elif recipe.parameters.local_features is not None:
        raise ValueError("it has no local features")


def attributes(view: SnapshotView) -> ViewAttributes:
    """What the user said of a view."""
    position = Position(**{name: getattr(view, name) for name in COORDINATES})
    return ViewAttributes(view.place, position, view.captured_at, view.metadata, view.filename)


def image_facts(view: SnapshotView) -> ImageFacts:
    """The facts of the image of a view."""
    return ImageFacts(view.width, view.height, view.byte_count, view.format, view.sha256)


def description_rows(
    view: SnapshotView, seq: int, map_id: int, recipe: str, revision: int
) -> dict[sa.Table, dict[str, Any]]:
    """The rows of a view's description, by table."""
    described = view.description
    if described is None:
        return {}
    row = {
        "seq": seq,
        "recipe": recipe,
        "map_id": map_id,
        "revision": revision,
        "descriptor_count": described.descriptor_count,
        "static_share": described.static_share,
        "nodes": described.nodes,
        "label_shares": described.label_shares,
    }
    rows = {DESCRIPTIONS: {**row, "checksum": checksums.of_row(DESCRIPTIONS, row)}}
    for name, table in PARTS.items():
        body = getattr(described, name)
        if body is not None:
            checksum = checksums.of_body(seq, recipe, body)
            rows[table] = {"seq": seq, "recipe": recipe, "body": body, "checksum": checksum}
    return rows
