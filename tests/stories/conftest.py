"""Stories that are told on both databases."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.storage.databases import DATABASES, postgres_schema
from tests.stories import running

ON_BOTH = (
    "test_a_map_that_keeps_no_images",
    "test_a_part_of_a_map_is_searched",
    "test_a_recording_is_imported",
    "test_a_stop_answers_every_caller",
    "test_an_app_is_told_what_queries_found",
    "test_an_app_that_speaks_compreface",
    "test_an_enrolment_tells_what_it_resembles",
    "test_nobody_waits_without_end",
    "test_several_maps_give_one_verdict",
    "test_the_clock_goes_back",
)
"""Of the others some are about the disk or the file of SQLite, some have a database of their own, some never store."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Tell these stories once for each database."""
    if metafunc.module.__name__.rpartition(".")[2] in ON_BOTH:
        metafunc.parametrize("database", DATABASES, indirect=True, scope="module")


@pytest.fixture(scope="module", autouse=True)
def database(request: pytest.FixtureRequest) -> Iterator[str]:
    """Where the services of a story keep their rows; a service that a whole module shares asks for it."""
    kind = str(getattr(request, "param", "sqlite"))
    if kind == "sqlite":
        yield kind
        return
    with ExitStack() as schemas:
        urls: dict[Path, str] = {}

        def url_of(data: Path) -> str:
            if data not in urls:
                urls[data] = schemas.enter_context(postgres_schema())
            return urls[data]

        running.rows_of = url_of
        try:
            yield kind
        finally:
            running.rows_of = None
