from collections.abc import Iterator

import pytest

from tests.http.fakes import FakeHouse, FakeRecogniser
from tests.openapi import CheckedClient


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
