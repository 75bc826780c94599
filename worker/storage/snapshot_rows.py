"""Conversion between rows and the lines of a snapshot; damaged rows never get into one."""

import json
from binascii import b2a_base64
from collections.abc import Iterator, Sequence
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from pydantic import ValidationError

from schemas.errors import BadSnapshot, Damaged
from schemas.image import ImageFacts
from schemas.recipe import DescriptionRecipe
from schemas.records import Position, ViewAttributes
from schemas.snapshot import SnapshotComparison, SnapshotDescription, SnapshotView
from worker.storage import checksums, packing
from worker.storage.damage import vectors_fault
from worker.storage.rows import COORDINATES, has_whole_attributes
from worker.storage.tables import APPEARANCES, CELLS, COMPARISONS, DESCRIPTIONS, KEYPOINTS, VECTORS, VIEWS

PARTS = {"vectors": VECTORS, "appearances": APPEARANCES, "cells": CELLS, "keypoints": KEYPOINTS}

_NONE = b"null"

DAMAGED_VIEW = (
    "the attributes of the view {} are damaged, so that no whole snapshot can be made; enrol its image again with its "
    "attributes, or delete it"
)


def view_lines(connection: sa.Connection, seqs: Sequence[int], recipe: DescriptionRecipe) -> list[tuple[str, bytes]]:
    """SHA-256 of the image and line of each view, in enrolment order; raises Damaged for attributes that are.

    A view whose description is missing or damaged goes without: where it is restored, it is described from its image.
    """
    views = connection.execute(sa.select(VIEWS).where(VIEWS.c.seq.in_(seqs)).order_by(VIEWS.c.seq)).all()
    described = _descriptions(connection, seqs, recipe)
    return [(row.sha256, _view_line(row, described.get(row.seq))) for row in views]


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
            if row.seq not in left_out and checksums.is_whole(COMPARISONS, row, row.checksum)
        ]


def _view_line(row: sa.Row[Any], described: dict[str, bytes] | None) -> bytes:
    if not has_whole_attributes(row):
        raise Damaged(DAMAGED_VIEW.format(row.id))
    ready = row.state == "ready" and described is not None
    failed = row.state == "failed"
    view = {
        "number": row.seq,
        "id": row.id,
        "place": row.place,
        **{name: getattr(row, name) for name in COORDINATES},
        "captured_at": _moment(row.captured_at),
        "metadata": json.loads(row.metadata),
        "filename": row.filename,
        "enrolled_at": _moment(row.enrolled_at),
        "elapsed_us": row.elapsed_us,
        "sha256": row.sha256,
        "sent_sha256": row.sent_sha256,
        "width": row.width,
        "height": row.height,
        "byte_count": row.byte_count,
        "format": row.format,
        "state": "ready" if ready else "failed" if failed else "pending",
        "failure_code": row.failure_code if failed else None,
        "failure_detail": row.failure_detail if failed else None,
    }
    facts = json.dumps(view, allow_nan=False, separators=(",", ":")).encode()
    if described is None or not ready:
        return facts[:-1] + b',"description":null}\n'
    # Joined by hand: an encoder would look at each letter of the Base64, which needs no escape.
    fields = b",".join(b'"%b":%b' % (name.encode(), value) for name, value in described.items())
    return b'%b,"description":{%b}}\n' % (facts[:-1], fields)


def _moment(value: datetime | None) -> str | None:
    return None if value is None else value.isoformat()


def _text(body: bytes) -> bytes:
    """Bytes as a JSON string of Base64."""
    return b'"%b"' % b2a_base64(body, newline=False)


def _descriptions(
    connection: sa.Connection, seqs: Sequence[int], recipe: DescriptionRecipe
) -> dict[int, dict[str, bytes]]:
    """Fields of whole descriptions, as JSON, by the sequence number of their view."""
    of = recipe.id  # a hash of all of it, made anew each time it is read
    by = DESCRIPTIONS.c.seq.in_(seqs), DESCRIPTIONS.c.recipe == of
    whole: dict[int, dict[str, bytes]] = {}
    for row in connection.execute(sa.select(DESCRIPTIONS).where(*by)):
        if checksums.is_whole(DESCRIPTIONS, row, row.checksum):
            whole[row.seq] = {
                "descriptor_count": b"%d" % row.descriptor_count,
                "static_share": json.dumps(row.static_share, allow_nan=False).encode(),
                "nodes": b"%d" % row.nodes,
                "label_shares": _text(row.label_shares),
                "keypoints": _NONE,
            }
    for name, table in PARTS.items():
        for part in connection.execute(sa.select(table).where(table.c.seq.in_(seqs), table.c.recipe == of)):
            if checksums.of_body(part.seq, of, part.body) != part.checksum:
                whole.pop(part.seq, None)
            elif part.seq in whole:
                whole[part.seq][name] = _text(part.body)
    needed = set(PARTS) - {"keypoints"}
    with_keypoints = recipe.parameters.local_features is not None
    return {
        seq: described
        for seq, described in whole.items()
        if needed <= described.keys() and not (with_keypoints and described["keypoints"] == _NONE)
    }


def read_lines(name: str, body: bytes, recipe: DescriptionRecipe) -> list[SnapshotView]:
    """The views of a part; raises BadSnapshot for anything that could not be stored."""
    views = []
    for number, line in enumerate(body.splitlines(), 1):
        view = _checked(SnapshotView, f"line {number} of its part {name}", line)
        if (view.description is not None) != (view.state == "ready"):
            raise BadSnapshot(
                f"the view {view.id} is {view.state} and has {'a' if view.description else 'no'} description"
            )
        if view.description is not None:
            try:
                _check_description(view.description, recipe)
            except ValueError as error:
                raise BadSnapshot(f"the description of the view {view.id} cannot be used: {error}") from None
        views.append(view)
    return views


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


def facts(view: SnapshotView) -> ImageFacts:
    """Of the image of a view."""
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
