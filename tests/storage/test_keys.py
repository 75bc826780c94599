"""Keys are kept as hashes, ended for ever, and restrict what lists show."""

from datetime import timedelta
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.errors import Conflict, InvalidParameters, NotFound, Unauthorized
from schemas.keys import Access, Rates
from schemas.records import Filters
from tests.storage.conftest import Open
from tests.storage.material import NOW, enroll
from worker.service.keys import KeyService
from worker.storage.examining import examine
from worker.storage.store import SqlStore


def test_a_key_is_known_again_by_another_process_and_its_secret_is_nowhere(store: SqlStore, reopen: Open) -> None:
    made = KeyService(store.keys)
    rates = Rates(requests=60, images=0, mb=1.5)
    record, key = made.create("robot", "write", NOW, maps=["b", "a", "b"], expires_at=NOW + timedelta(1), rates=rates)
    other = reopen()

    assert other.keys.all() == [record]
    assert record.maps == ("a", "b")
    access = KeyService(other.keys).read().access(key, NOW)
    assert access == Access("write", frozenset({"a", "b"}), "robot", record.id, rates)
    assert key.encode() not in b"".join(path.read_bytes() for path in other._data.rglob("*") if path.is_file())


def test_a_name_belongs_to_one_key_in_force(store: SqlStore) -> None:
    keys = KeyService(store.keys)
    _, first = keys.create("robot", "read", NOW)
    with pytest.raises(Conflict, match="revoke"):
        keys.create("robot", "admin", NOW)
    keys.revoke("robot", NOW)
    _, second = keys.create("robot", "read", NOW)

    ring = keys.read()
    with pytest.raises(Unauthorized, match="revoked"):
        ring.access(first, NOW)
    assert ring.access(second, NOW).key == "robot"
    keys.revoke("robot", NOW)
    with pytest.raises(NotFound):
        keys.revoke("robot", NOW)


def test_a_key_ends_by_itself(store: SqlStore) -> None:
    keys = KeyService(store.keys)
    _, key = keys.create("visitor", "read", NOW, expires_at=NOW + timedelta(days=90))
    ring = keys.read()
    assert ring.access(key, NOW + timedelta(days=89)).key == "visitor"
    with pytest.raises(Unauthorized, match="expired"):
        ring.access(key, NOW + timedelta(days=90))


def test_use_is_noted_once_an_hour_and_a_key_that_nobody_got_is_forgotten(store: SqlStore) -> None:
    keys = KeyService(store.keys)
    record, key = keys.create("robot", "read", NOW)
    access = keys.read().access(key, NOW)
    keys.note(access, NOW + timedelta(minutes=59))
    assert keys.is_noted(access, NOW + timedelta(minutes=59))
    assert store.keys.all()[0].last_used_at == NOW
    keys.remove(record.id)
    assert not keys.read().closed
    keys.create("a", "read", NOW)
    keys.create("b", "read", NOW)
    assert keys.clear() == 2
    assert store.keys.all() == []


def test_lists_show_the_maps_that_are_allowed(store: SqlStore) -> None:
    for number, name in enumerate(("campus", "depot", "attic")):
        enroll(store, f"gate-{number}", map=name)
    allowed = frozenset({"depot", "attic", "nowhere"})

    views, _ = store.views.list(None, Filters(), among=allowed)
    jobs, _ = store.jobs.list(None, among=allowed)
    assert {view.map for view in views} == {job.map for job in jobs} == {"depot", "attic"}
    assert {row[0] for row in store.listings.places(None, None, 10, allowed)[0]} <= {"depot", "attic"}
    assert store.views.list(None, Filters(), among=frozenset())[0] == []
    page, cursor = store.views.list(None, Filters(), among=allowed, limit=1)
    assert cursor is not None
    assert {view.map for view in (*page, *store.views.list(None, Filters(), among=allowed, cursor=cursor)[0])} == {
        "depot",
        "attic",
    }
    campus, *others = (store.views.list(name, Filters())[0][0] for name in ("campus", "depot", "attic"))
    newer = enroll(store, "last", map="campus").view
    for filters in (Filters(exclude_last=1), Filters(exclude=(others[1].id,))):
        left, _ = store.views.list(None, filters, among=allowed)
        assert [view.id for view in left] == [others[0].id]
    for hidden in (campus, newer):
        with pytest.raises(InvalidParameters, match=hidden.id):
            store.views.list(None, Filters(exclude=(hidden.id,)), among=allowed)


@pytest.mark.parametrize(
    ("column", "value"),
    [("maps", "no JSON"), ("maps", '["a", "c"]'), ("scope", "admin"), ("digest", b"\0"), ("created_at", "never")],
)
def test_a_damaged_key_opens_nothing_and_leaves_the_others_in_force(
    store: SqlStore, database_url: str, column: str, value: Any
) -> None:
    """Nor does it open the service, when it is the only one: it counts as revoked."""
    keys = KeyService(store.keys)
    _, damaged = keys.create("robot", "read", NOW, maps=["a", "b"])
    if column == "created_at" and not database_url.startswith("sqlite"):
        pytest.skip("PostgreSQL keeps nothing but times there")
    value = sa.literal(value, sa.LargeBinary if isinstance(value, bytes) else sa.Text)
    with store._database.engine.begin() as connection:
        connection.execute(sa.update(sa.table("keys", sa.column(column))).values({column: value}))
    _, whole = keys.create("console", "admin", NOW)

    ring = keys.read()
    with pytest.raises(Unauthorized):
        ring.access(damaged, NOW)
    assert ring.access(whole, NOW).key == "console"
    keys.revoke("console", NOW)
    assert keys.read().closed
    assert [finding.where for finding in examine(database_url, store._data)] == ["key robot"]
