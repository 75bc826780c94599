from collections.abc import Iterator

import pytest

from tests.openapi import CheckedClient
from tests.routes.fakes import FakeHouse, FakeRecogniser


@pytest.fixture
def house() -> FakeHouse:
    return FakeHouse()


@pytest.fixture
def recogniser(house: FakeHouse) -> FakeRecogniser:
    return house.recogniser


@pytest.fixture
def client(house: FakeHouse) -> Iterator[CheckedClient]:
    with CheckedClient(house.app()) as client:
        yield client
