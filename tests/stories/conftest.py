"""Stories are told on both databases, unless they are marked ``one_database`` with the reason."""

from collections.abc import Iterator
from contextlib import ExitStack
from functools import cache
from pathlib import Path

import pytest

from tests.described_once import describe_once
from tests.storage.databases import DATABASES, postgres_tables
from tests.stories import running
from worker.encoders.compact import onnx

SQLITE, POSTGRESQL = DATABASES


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Tell a story once for each database."""
    marks = [*metafunc.definition.iter_markers("one_database")]
    assert all(mark.args and str(mark.args[0]).strip() for mark in marks), f"{metafunc.definition.nodeid}: say why"
    metafunc.parametrize("database", (SQLITE,) if marks else DATABASES, indirect=True, scope="module")


@pytest.fixture(scope="module", autouse=True)
def _the_same_once() -> Iterator[None]:
    """Stories enrol the same images again and again, by services that would each load the same graphs."""
    with pytest.MonkeyPatch.context() as patch:
        describe_once(patch.setattr)
        patch.setattr(onnx, "open_session", cache(onnx.open_session))
        yield


@pytest.fixture(scope="module", autouse=True)
def database(request: pytest.FixtureRequest) -> Iterator[str]:
    """Where the services of a story keep their rows; a fixture that a whole module shares asks for it."""
    kind, failed = str(request.param), request.session.testsfailed
    rows: dict[Path, str] = {}
    in_the_folder = running.rows_of
    with ExitStack() as schemas:

        def url_of(data: Path) -> str:
            if data not in rows:
                rows[data] = schemas.enter_context(postgres_tables())
            return rows[data]

        if kind == POSTGRESQL:
            running.rows_of = url_of
        try:
            yield kind
        finally:
            running.rows_of = in_the_folder
    if kind == POSTGRESQL and request.session.testsfailed == failed:
        assert rows, f"{request.module.__name__} stores nothing in the database that it is given: mark it one_database"
