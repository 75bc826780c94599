"""The tables come from migrations alone, and a data folder is used by those who may."""

import json
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext

from schemas.errors import SetupError
from schemas.recipe import CAME_LATER, DescriptionRecipe, RankingConfig
from schemas.records import Position, Replay, ViewAttributes
from tests.storage.conftest import Open
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW, describe_all, enroll
from worker.description.ports import Encoder
from worker.description.presets import Wanted, make_recipe
from worker.encoders.color import ColorEncoder
from worker.encoders.compact.encoder import CompactEncoder
from worker.storage import migrating
from worker.storage.database import Database
from worker.storage.examining import examine
from worker.storage.locks import USE, FolderLock, lock_for_serving
from worker.storage.migrating import migrate, newest
from worker.storage.store import open_store
from worker.storage.tables import METADATA

_MIGRATION = import_module("worker.storage.migrations.versions.0003_two_halves_of_a_recipe")
halves, identity = _MIGRATION.halves, _MIGRATION.identity


def set_revision(database: Database, revision: str) -> None:
    with database.writing() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})


def test_migrations_make_the_tables_of_the_code(reopen: Open, database_url: str) -> None:
    reopen()
    database = Database(database_url)
    with database.reading() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, METADATA) == []
    database.close()


def test_migrations_make_them_to_the_letter(data: Path) -> None:
    """Beyond what Alembic compares: actions of foreign keys, AUTOINCREMENT, collations."""

    def schema(database: Database) -> dict[str, list[str]]:
        with database.reading() as connection:
            rows = connection.execute(sa.text("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
            return {name: definitions(sql) for name, sql in rows if not name.startswith("alembic")}

    def definitions(sql: str) -> list[str]:
        """Columns and constraints; in any order, since ALTER TABLE writes new columns behind the constraints."""
        parts, depth = [""], 0
        for letter in re.sub(r"\s+", " ", sql):
            depth += {"(": 1, ")": -1}.get(letter, 0)
            if letter == "," and depth == 1:
                parts.append("")
            else:
                parts[-1] += letter
        first, last = parts[0].partition("("), parts[-1].rpartition(")")
        return sorted(part.strip() for part in [first[0], first[2], *parts[1:-1], last[0], last[2]])

    by_code, by_migrations = Database(sqlite_url(data / "code")), Database(sqlite_url(data))
    (data / "code").mkdir()
    with by_code.writing() as connection:
        METADATA.create_all(connection)
    open_store(sqlite_url(data), data).close()
    assert schema(by_code) == schema(by_migrations)
    by_code.close()
    by_migrations.close()


def test_a_migration_that_fails_leaves_nothing_behind(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("in the middle")

    with monkeypatch.context() as patch:
        patch.setattr("alembic.op.execute", fail)
        with pytest.raises(RuntimeError):
            open_store(sqlite_url(data), data)
    database = Database(sqlite_url(data))
    assert sa.inspect(database.engine).get_table_names() == []
    database.close()
    open_store(sqlite_url(data), data).close()


def test_migrating_twice_changes_nothing(reopen: Open, database_url: str, data: Path) -> None:
    store = reopen()
    view = enroll(store, "gate").view
    store.close()
    assert migrate(database_url, data) == migrate(database_url, data) == newest()
    assert reopen().views.get(view.id) == view


def test_a_database_of_a_newer_version_is_refused(reopen: Open, database_url: str) -> None:
    reopen().close()
    database = Database(database_url)
    set_revision(database, "9999")
    database.close()
    with pytest.raises(SetupError, match=r"9999, which is newer.*put the backup from before the upgrade"):
        reopen()


def test_a_database_in_use_is_not_migrated(data: Path) -> None:
    share = FolderLock(data / USE)
    share.acquire(shared=True)
    with pytest.raises(SetupError, match="stop all services"):
        open_store(sqlite_url(data), data)
    share.release()
    open_store(sqlite_url(data), data).close()


def test_a_folder_has_one_service_and_the_second_is_told_which(data: Path) -> None:
    first = lock_for_serving(data, NOW)
    with pytest.raises(SetupError, match=r"process \d+ on .+ since 2026-03-01 12:00:00\+00:00; stop"):
        lock_for_serving(data, NOW)
    first.release()
    first.release()
    lock_for_serving(data, NOW).release()


def test_any_number_of_workers_may_use_a_folder_beside_its_service(reopen: Open, data: Path) -> None:
    service = lock_for_serving(data, NOW)
    assert [reopen().check() for _ in range(3)] == ["ok"] * 3
    service.release()


@pytest.mark.parametrize("url", ["moon", "sqlite://", "sqlite:///:memory:", "mysql://localhost/revisit"])
def test_a_database_that_cannot_be_used_is_refused(url: str, data: Path) -> None:
    with pytest.raises(SetupError, match="REVISIT_DATABASE"):
        open_store(url, data)


def test_what_is_no_database_and_no_folder_is_refused_in_words(data: Path) -> None:
    (data / "revisit.db").write_text("a letter home " * 100)
    with pytest.raises(SetupError, match="the database cannot be used: file is not a database"):
        open_store(sqlite_url(data), data)
    with pytest.raises(SetupError, match="the data folder"):
        open_store(sqlite_url(data), data / "revisit.db")


def test_maps_of_a_build_before_the_first_release_are_refused(database_url: str, data: Path) -> None:
    database = Database(database_url)
    upgrade(database, "0001")
    with database.writing() as connection:
        connection.execute(sa.text("INSERT INTO recipes (id, body) VALUES ('old', '{}')"))
        connection.execute(
            sa.text(
                "INSERT INTO maps (name, recipe, revision, anew, created_at) VALUES ('campus', 'old', 1, 1, :moment)"
            ),
            {"moment": MOMENT},
        )
    with pytest.raises(SetupError, match="enrol the images again"):
        migrate(database_url, data)
    with database.writing() as connection:
        connection.execute(sa.text("DELETE FROM maps"))
    database.close()
    migrate(database_url, data)
    open_store(database_url, data).close()


# 0003: two halves of a recipe

MOMENT = "2026-03-01 12:00:00.000000"

BEFORE = json.loads(Path(__file__).with_name("recipes_before_0003.json").read_text())
"""Recipes as the version before made and named them, by encoder and preset."""

ENCODERS: dict[str, Encoder] = {"color": ColorEncoder(), "compact": CompactEncoder()}


@pytest.mark.parametrize("name", BEFORE)
def test_a_recipe_of_before_becomes_the_halves_that_can_be_made_today(name: str) -> None:
    """Nothing is described anew: a map made today can share descriptions with those of before, keypoints included."""
    encoder, preset, *changed = name.split()
    ranking = {"candidates": 25, "detail_only_top_k": 0} if changed else None
    today = make_recipe(ENCODERS[encoder], Wanted(parameters=CAME_LATER, ranking=ranking), preset=preset)

    description, ranked = halves(json.loads(BEFORE[name]["body"]))

    then = DescriptionRecipe.model_validate(description)
    assert (identity(description), then) == (today.description.id, today.description)
    assert then.id == today.description.id
    # Maps of before go without the shortlist, which changes answers in large maps, and keep their weights.
    ranking_then = RankingConfig.model_validate(ranked)
    weights = today.ranking.weights.model_copy(update={"verification": ranking_then.weights.verification})
    none = {"shortlist_from": 0, "shortlist_looked": 0, "shortlist_kept": 0}
    assert ranking_then == today.ranking.model_copy(update={**none, "weights": weights})
    if "default" in name:
        assert ranking_then.weights.verification == 0.2


def test_a_data_folder_of_before_keeps_its_views_descriptions_jobs_and_their_order(
    database_url: str, data: Path
) -> None:
    database = Database(database_url)
    upgrade(database, "0002")
    default, changed = BEFORE["compact default"], BEFORE["compact default changed"]
    with database.writing() as connection:
        rows = {
            "recipes": [{"id": r["id"], "body": r["body"]} for r in (default, changed)],
            "maps": [
                {"id": number, "name": name, "recipe": recipe, "revision": 5, "anew": 1, "created_at": MOMENT}
                for number, name, recipe in ((1, "campus", default["id"]), (2, "museum", changed["id"]))
            ],
            "views": [_old_view(1, 1), _old_view(2, 1), _old_view(3, 2)],
            "descriptions": [
                _old_description(1, default["id"], 3),
                _old_description(1, changed["id"], 4),  # as a roll-back left it: by what is now the same recipe
                _old_description(3, changed["id"], 5),
            ],
            **{
                part: [
                    {"seq": seq, "recipe": recipe, "body": f"{part} {seq} {recipe}".encode()}
                    for seq, recipe in ((1, default["id"]), (1, changed["id"]), (3, changed["id"]))
                ]
                for part in ("vectors", "appearances", "cells", "keypoints")
            },
            "jobs": [_old_job(7, 1, 1, default["id"], "done"), _old_job(9, 1, 2, default["id"], "waiting")],
        }
        for table, values in rows.items():
            for value in values:
                names = ", ".join(value)
                slots = ", ".join(f":{name}" for name in value)
                connection.execute(sa.text(f"INSERT INTO {table} ({names}) VALUES ({slots})"), value)
    database.close()

    migrate(database_url, data)

    store = open_store(database_url, data)
    campus, museum = store.maps.get("campus"), store.maps.get("museum")
    assert campus.description == museum.description
    assert (campus.ranking.candidates, museum.ranking.candidates) == (50, 25)
    assert (campus.ranking.detail_only_top_k, museum.ranking.detail_only_top_k) == (6, 0)
    states = [store.views.get(f"view-{seq}").state for seq in (1, 2, 3)]
    assert states == ["ready", "pending", "ready"]
    recipe = campus.description.id
    database = Database(database_url)
    with database.reading() as connection:
        for part in ("vectors", "appearances", "cells", "keypoints"):
            bodies = connection.execute(sa.text(f"SELECT seq, recipe, body FROM {part} ORDER BY seq")).all()
            assert [(row.seq, row.recipe) for row in bodies] == [(1, recipe), (3, recipe)]
            assert {bytes(row.body).split()[0] for row in bodies} == {part.encode()}
        assert connection.scalar(sa.text("SELECT count(*) FROM recipes")) == 1
    database.close()
    jobs, _ = store.jobs.list("campus")
    assert [(job.id, job.kind, job.state) for job in jobs] == [
        ("job-9", "describe", "waiting"),
        ("job-7", "describe", "done"),
    ]
    [claim] = store.jobs.claim("worker", 5)
    assert (claim.job_id, claim.recipe) == ("job-9", campus.description)
    job = store.jobs.queue_vocabulary("museum", NOW)
    assert store.jobs.list(None)[0][0].id == job.id
    store.close()


def upgrade(database: Database, revision: str) -> None:
    """Bring an empty database to the tables of an older version."""
    config = migrating._config()
    with database.writing() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, revision)


def _old_view(seq: int, map_id: int) -> dict[str, object]:
    return {
        "seq": seq, "id": f"view-{seq}", "map_id": map_id, "metadata": "{}", "enrolled_at": MOMENT,
        "sha256": f"{seq:064x}", "width": 640, "height": 480, "byte_count": 9, "format": "png",
        "state": "pending" if seq == 2 else "ready",
    }  # fmt: skip


def _old_description(seq: int, recipe: str, revision: int) -> dict[str, object]:
    return {
        "seq": seq, "recipe": recipe, "map_id": 2 if seq == 3 else 1, "revision": revision, "descriptor_count": 1,
        "static_share": 1.0, "nodes": 0, "label_shares": b"",
    }  # fmt: skip


def _old_job(number: int, map_id: int, seq: int, recipe: str, state: str) -> dict[str, object]:
    return {
        "number": number, "id": f"job-{number}", "map_id": map_id, "seq": seq, "recipe": recipe, "background": False,
        "state": state, "attempts": 0, "created_at": MOMENT,
    }  # fmt: skip


# 0007: checksums

LATER = ("keys", "kept_queries", "day_scores")


def without_later(connection: sa.Connection) -> None:
    """Take away what came after revision 0008."""
    connection.exec_driver_sql("DROP TABLE installation")
    connection.exec_driver_sql("DROP TABLE deleted_images")
    connection.exec_driver_sql("DROP TABLE kept_queries")
    connection.exec_driver_sql("DROP TABLE day_scores")
    connection.exec_driver_sql("DROP INDEX views_by_sent")
    for column in (
        "views.filename",
        "comparisons.rival",
        "comparisons.own",
        "jobs.refuse_poor",
        "jobs.told",
        "workers.encoder",
        "comparisons.breadth",
        "maps.keep_queries",
        "maps.refuse_poor",
        "maps.drop_images",
        "maps.keep_matches",
        "maps.shadow",
        "maps.blur",
        "maps.edited",
        "maps.given_up_at",
        "views.sent_sha256",
    ):
        table, name = column.split(".")
        connection.exec_driver_sql(f"ALTER TABLE {table} DROP COLUMN {name}")


def without_0022(connection: sa.Connection) -> None:
    """Take away what came with revision 0022, and later."""
    connection.exec_driver_sql("DROP TABLE deleted_images")
    for table, column in (("jobs", "told"), ("workers", "encoder")):
        connection.exec_driver_sql(f"ALTER TABLE {table} DROP COLUMN {column}")
    connection.exec_driver_sql("DROP INDEX kept_queries_in_order")
    connection.exec_driver_sql("ALTER TABLE kept_queries DROP COLUMN number")
    connection.exec_driver_sql("CREATE INDEX kept_queries_by_map ON kept_queries (map_id, id)")


def test_rows_of_before_get_their_checksums(database_url: str, data: Path) -> None:
    """The same rows as this version writes, and so no finding: written without checksums, then migrated."""
    store = open_store(database_url, data)
    enroll(store, "gate", attributes=ViewAttributes("gate", Position(x=-0.0, y=1e-7, heading=12.5), NOW, {"floor": 2}))
    enroll(store, "yard")
    describe_all(store)
    store.jobs.queue_vocabulary("campus", NOW)
    store.calls.begin("key", "print", NOW)
    store.calls.end("key", Replay(201, {"location": "/views/1"}, b"{}"), NOW)
    store.removals.delete_view(enroll(store, "pier").view.id)
    store.close()
    assert list(examine(database_url, data)) == []
    database = Database(database_url)
    with database.writing() as connection:
        for name in ("maps", "comparisons", "jobs", "tombstones", "calls"):
            connection.exec_driver_sql(f"DROP INDEX {name}_unsealed")
        connection.exec_driver_sql("DROP TABLE keys")  # of later versions, as what follows
        without_later(connection)
        tables = [table.name for table in METADATA.sorted_tables if "checksum" in table.c]
        for name in [name for name in tables if name not in LATER]:
            connection.exec_driver_sql(f"ALTER TABLE {name} DROP COLUMN checksum")
    set_revision(database, "0006")
    database.close()
    assert [finding.remedy for finding in examine(database_url, data)] == ["./revisit migrate"]

    migrate(database_url, data)

    assert list(examine(database_url, data)) == []


# 0009: file names


def test_views_of_before_file_names_stay_whole_and_new_ones_have_theirs(database_url: str, data: Path) -> None:
    store = open_store(database_url, data)
    before = enroll(store, "gate", attributes=ViewAttributes("gate", Position(x=1.0, y=2.0))).view
    store.close()
    database = Database(database_url)
    with database.writing() as connection:
        without_later(connection)
    set_revision(database, "0008")
    database.close()

    migrate(database_url, data)

    assert list(examine(database_url, data)) == []
    store = open_store(database_url, data)
    after = enroll(store, "yard", attributes=ViewAttributes("yard", filename="IMG_1.jpg")).view
    assert (store.views.get(before.id).state, store.views.get(before.id).attributes) == ("pending", before.attributes)
    assert store.views.get(after.id).attributes.filename == "IMG_1.jpg"
    assert store.views.change(before.id, lambda had: replace(had, place="gates")).attributes.filename is None
    store.close()
    assert list(examine(database_url, data)) == []
