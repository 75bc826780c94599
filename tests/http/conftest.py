from collections.abc import Iterator

import pytest

from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.openapi import CheckedClient


@pytest.fixture
def runtime() -> FakeRuntime:
    return FakeRuntime()


@pytest.fixture
def recogniser(runtime: FakeRuntime) -> FakeRecogniser:
    return runtime.recogniser


@pytest.fixture
def client(runtime: FakeRuntime) -> Iterator[CheckedClient]:
    with CheckedClient(runtime.app()) as client:
        yield client
