"""A map's recipe becomes a description recipe and a ranking config; the table of jobs also holds jobs of maps.

Stored descriptions stay as they are. Only the ids of recipes change, since they are hashes of their content: rows of
descriptions get the new id, and ranking parameters move to the map.
"""

import hashlib
import json
from typing import Any

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime, big_key

revision = "0003"
down_revision = "0002"

PARTS = ("vectors", "appearances", "cells", "keypoints")
LAYERS = {"words": "semantic"}
TERMS = {"close": "dense_full"}


def upgrade() -> None:
    """Add columns, replace the table of jobs, and convert all recipes."""
    op.add_column("maps", sa.Column("ranking", sa.Text, nullable=False, server_default="{}"))
    op.add_column("maps", sa.Column("next_ranking", sa.Text))
    op.add_column("maps", sa.Column("previous_recipe", sa.Text))
    _new_jobs()
    connection = op.get_bind()
    rankings: dict[str, str] = {}
    names: dict[str, str] = {}
    for old, body in connection.execute(sa.text("SELECT id, body FROM recipes")).all():
        description, ranking = halves(json.loads(body))
        names[old], rankings[old] = identity(description), _canonical(ranking)
        exists = connection.scalar(sa.text("SELECT count(*) FROM recipes WHERE id = :id"), {"id": names[old]})
        if not exists:
            connection.execute(
                sa.text("INSERT INTO recipes (id, body) VALUES (:id, :body)"),
                {"id": names[old], "body": _canonical(description)},
            )
    for old, new in names.items():
        _move(connection, old, new)
        connection.execute(
            sa.text("UPDATE maps SET ranking = :ranking, recipe = :new WHERE recipe = :old"),
            {"ranking": rankings[old], "new": new, "old": old},
        )
        connection.execute(
            sa.text("UPDATE maps SET next_ranking = :ranking, next_recipe = :new WHERE next_recipe = :old"),
            {"ranking": rankings[old], "new": new, "old": old},
        )
        connection.execute(sa.text("UPDATE jobs SET recipe = :new WHERE recipe = :old"), {"new": new, "old": old})
        connection.execute(sa.text("DELETE FROM recipes WHERE id = :old"), {"old": old})


def _move(connection: sa.Connection, old: str, new: str) -> None:
    """Move descriptions from one recipe id to another; where a view has both, the first is kept."""
    columns = "seq, map_id, revision, descriptor_count, static_share, nodes, label_shares"
    connection.execute(
        sa.text(
            f"INSERT INTO descriptions (recipe, {columns}) SELECT :new, {columns} FROM descriptions AS was "
            "WHERE was.recipe = :old AND NOT EXISTS "
            "(SELECT 1 FROM descriptions AS there WHERE there.seq = was.seq AND there.recipe = :new)"
        ),
        {"new": new, "old": old},
    )
    for part in PARTS:
        connection.execute(
            sa.text(
                f"UPDATE {part} SET recipe = :new WHERE recipe = :old AND NOT EXISTS "
                f"(SELECT 1 FROM {part} AS there WHERE there.seq = {part}.seq AND there.recipe = :new)"
            ),
            {"new": new, "old": old},
        )
    connection.execute(sa.text("DELETE FROM descriptions WHERE recipe = :old"), {"old": old})


def _new_jobs() -> None:
    """Replace the table of jobs: a job of a map has no view, and no recipe before training has ended."""
    op.rename_table("jobs", "jobs_before")
    for index in ("jobs_in_order", "jobs_by_recipe", "jobs_by_view"):
        op.drop_index(index, "jobs_before")
    op.create_table(
        "jobs",
        sa.Column("number", big_key(), primary_key=True),
        sa.Column("id", sa.Text, nullable=False, unique=True),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("map_id", sa.BigInteger, nullable=False),
        sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE")),
        sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id")),
        sa.Column("background", sa.Boolean, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("worker", sa.Text),
        sa.Column("token", sa.Text),
        sa.Column("lease_until", UtcDateTime),
        sa.Column("progress_done", sa.Integer),
        sa.Column("progress_total", sa.Integer),
        sa.Column("result", sa.Text),
        sa.Column("created_at", UtcDateTime, nullable=False),
        sa.Column("finished_at", UtcDateTime),
        sa.Column("failure_code", sa.Text),
        sa.Column("failure_detail", sa.Text),
        sqlite_autoincrement=True,
    )
    kept = (
        "number, id, map_id, seq, recipe, background, state, attempts, worker, token, lease_until, created_at, "
        "finished_at, failure_code, failure_detail"
    )
    op.execute(f"INSERT INTO jobs (kind, {kept}) SELECT 'describe', {kept} FROM jobs_before")
    op.drop_table("jobs_before")
    connection = op.get_bind()
    if connection.dialect.name == "postgresql":  # numbers continue after the copied ones
        op.execute(
            "SELECT setval(pg_get_serial_sequence('jobs', 'number'), "
            "(SELECT coalesce(max(number), 0) + 1 FROM jobs), false)"
        )
    op.create_index("jobs_in_order", "jobs", ["kind", "state", "background", "number"])
    op.create_index("jobs_by_recipe", "jobs", ["map_id", "recipe", "state"])
    op.create_index("jobs_by_view", "jobs", ["seq", "recipe"])


# Conversion of recipes. Frozen: later versions of the schema do not change it.


def halves(recipe: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Description recipe and ranking config of an earlier recipe, with the fields of this revision."""
    parameters = recipe["parameters"]
    dense, verification = parameters["dense"], parameters["verification"]
    channels = {
        LAYERS.get(name, name): {
            "layer": LAYERS.get(c["layer"], c["layer"]),
            "vocabulary_size": c["words"],
            "descriptors": c["descriptors"],
            "assignments": c["assignments"],
            "temperature": float(c["temperature"]),
            "normalisation": c["normalisation"],
            "dimensions": c["dimensions"],
        }
        for name, c in parameters["channels"].items()
    }
    description = {
        "encoder": recipe["encoder"],
        "weights": recipe["weights"],
        "labels": recipe["labels"],
        "dynamic": recipe["dynamic"],
        "parameters": {
            "channels": channels,
            "seed": parameters["seed"],
            "dynamic": {key: float(value) for key, value in parameters["dynamic"].items()},
            "dense": None
            if dense is None
            else {
                "rows": dense["rows"],
                "columns": dense["columns"],
                "dimensions": dense["dimensions"],
                "channel_weights": {LAYERS.get(n, n): float(w) for n, w in dense["shares"].items()},
            },
            "graph": {"min_region_cells": parameters["graph"]["min_region_cells"]},
            "local_features": None if verification is None else verification["keypoints"],
        },
        "vocabulary": recipe["vocabulary"],
    }
    return description, _ranking(recipe["preset"], parameters)


def _ranking(preset: str, parameters: dict[str, Any]) -> dict[str, Any]:
    dense, verification = parameters["dense"], parameters["verification"]
    given = parameters["weights"]
    histogram = {}
    weights: dict[str, Any] = {"dense_full": 0.0, "dense": 0.0, "graph": 0.0, "verification": 0.0}
    for term, weight in given.items():
        kind, _, channel = term.partition(".")
        name = TERMS.get(kind, kind)
        counted = max(0.0, float(weight))  # negative weights were accepted, without a meaning
        if name == "histogram" and LAYERS.get(channel, channel) in {LAYERS.get(c, c) for c in parameters["channels"]}:
            histogram[LAYERS.get(channel, channel)] = counted
        elif name in weights:
            weights[name] = counted
    if not any(weights.values()) and not any(histogram.values()):
        weights["graph"] = 1.0
    return {
        "preset": preset,
        "mode": parameters["ranking"],
        "candidates": parameters["candidates"],
        "weights": {
            "dense_full": weights["dense_full"],
            "dense": weights["dense"],
            "histogram": histogram,
            "graph": weights["graph"],
            "verification": weights["verification"],
        },
        "full_resolution_top_k": 0 if dense is None else dense["closely"],
        "detail_only_top_k": 0 if dense is None else int(dense.get("alone", {}).get("detail", 0)),
        "scale_penalty": 0.0 if dense is None else float(dense.get("scale_penalty", 0.0)),
        "graph_cosine": float(parameters["graph"]["cosine"]),
        "graph_max_edge": float(parameters["graph"]["tau"]),
        "verified_top_k": 0 if verification is None else verification["candidates"],
    }


def _canonical(value: dict[str, Any]) -> str:
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False)


def identity(description: dict[str, Any]) -> str:
    """First 16 hex digits of the SHA-256 of the recipe as canonical JSON."""
    text = json.dumps(description, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
