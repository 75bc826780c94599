"""Another copy of a database that works on the same images is noticed before this one removes what it needs."""

import pytest
import sqlalchemy as sa

from schemas.errors import SetupError
from tests.storage.conftest import Place
from tests.storage.material import enroll, facts, image
from tests.storage.test_ownership import served
from worker.storage import owner_file
from worker.storage.examining import examine
from worker.storage.object_files import ObjectFiles
from worker.storage.repairing import repair
from worker.storage.signs import ALIVE, SLACK, Sign, SignsOfLife, read, refuse_copy
from worker.storage.tables import INSTALLATION

pytestmark = pytest.mark.parametrize("place", ["objects", "objects, postgresql"], indirect=True)


def never(seconds: float) -> None:
    raise AssertionError("nothing is waited for")


def test_each_process_counts_in_the_database_and_then_beside_the_images(place: Place) -> None:
    place.store.recover()
    for _ in range(2):
        _give(place)
    place.store.signs.give()  # a moment later
    place.store.signs.give()

    sign = read(_files(place))

    assert sign is not None
    assert (sign.owner, sign.beats) == (place.store._images.owner(), 3)
    assert 0 <= sign.age_s < 60
    refuse_copy(place.store._database, _files(place), never)


def test_a_copy_is_not_served_beside_the_first_one(place: Place) -> None:
    for _ in range(SLACK + 2):
        _give(place)
    first = _sign(place)
    _set_count(place, 1)  # as when it was copied
    looks: list[float] = []

    def rest(seconds: float) -> None:
        looks.append(seconds)
        if len(looks) == 3:
            _write(place, first._replace(beats=first.beats + 1))

    with pytest.raises(SetupError, match="a copy of this database"):
        refuse_copy(place.store._database, _files(place), rest)
    assert len(looks) == 3


@pytest.mark.parametrize("found", ["at once", "while it waits"])
def test_a_database_that_was_restored_waits_until_the_services_of_before_are_silent(
    place: Place, monkeypatch: pytest.MonkeyPatch, found: str
) -> None:
    for _ in range(SLACK + 2):
        _give(place)
    _set_count(place, 1)
    ages = [95.0] if found == "at once" else [20.0, 50.0, 89.0, 91.0]
    rests: list[float] = []
    usual = ages.copy()
    monkeypatch.setattr(ObjectFiles, "age_s", lambda files, name: usual.pop(0))

    refuse_copy(place.store._database, _files(place), rests.append)

    assert len(rests) == len(ages) - 1


def test_services_of_one_database_start_beside_each_other(place: Place) -> None:
    """Also where its server took over from another one that had not told it the last counts."""
    for _ in range(SLACK + 3):
        _give(place)
    _set_count(place, 3)
    refuse_copy(place.store._database, _files(place), never)
    _set_count(place, 2)  # it lacks more, but a service of its own goes on with it

    refuse_copy(place.store._database, _files(place), lambda _: _give(place))

    assert _sign(place).beats == 3


@pytest.mark.parametrize("written", ["of another database", "damaged", "nothing"])
def test_what_says_nothing_of_this_database_is_no_sign(place: Place, written: str) -> None:
    _give(place)
    sign = _sign(place)
    if written == "of another database":
        _write(place, Sign("somebody else", 99, 0))
    elif written == "damaged":
        body = owner_file.written(f"{sign.owner}:{sign.beats}").replace(b":1 ", b":9 ")
        _files(place).write(ALIVE, body)
    else:
        _files(place).remove(ALIVE)
    refuse_copy(place.store._database, _files(place), never)


def test_while_the_store_is_away_nothing_is_known(place: Place) -> None:
    for _ in range(SLACK + 2):
        _give(place)
    _set_count(place, 1)
    assert place.objects is not None
    place.objects.stop()
    try:
        _give(place)
        refuse_copy(place.store._database, _files(place), never)
    finally:
        place.objects.start()


def test_the_doctor_removes_nothing_of_the_other_copy(place: Place) -> None:
    enroll(place.store, "gate")
    served(place)
    for _ in range(SLACK + 2):
        _give(place)
    url, left = place.url, facts(image("pond")).sha256
    _set_count(place, 0)
    place.put(left, image("pond"))  # which the other one enrolled since
    place.store.close()

    findings = [finding.what for finding in examine(url, place.data, images=place.address)]
    repair(url, place.data, images=place.address)

    assert findings == ["was ahead of this database a moment ago: another copy of it is served with these images"]
    assert left in place.digests()


def test_a_folder_of_images_has_one_service(place: Place) -> None:
    SignsOfLife(place.store._database, None).give()
    refuse_copy(place.store._database, None, never)
    assert read(_files(place)) is None


def _files(place: Place) -> ObjectFiles:
    found = place.store._images.prompt
    assert found is not None
    return found


def _give(place: Place) -> None:
    """A sign of a process that gives its first one."""
    SignsOfLife(place.store._database, _files(place)).give()


def _sign(place: Place) -> Sign:
    found = read(_files(place))
    assert found is not None
    return found


def _write(place: Place, sign: Sign) -> None:
    _files(place).write(ALIVE, owner_file.written(f"{sign.owner}:{sign.beats}"))


def _set_count(place: Place, count: int) -> None:
    with place.store._database.writing() as connection:
        connection.execute(sa.update(INSTALLATION).values(beats=count))
