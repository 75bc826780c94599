from collections.abc import Iterator

import pytest

from tests.cli.fake_service import FakeService, fake_service


@pytest.fixture(autouse=True)
def _commands_know_no_settings_of_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("REVISIT_TEST_POSTGRES", raising=False)


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeService]:
    """A service at REVISIT_URL."""
    with fake_service() as fake:
        monkeypatch.setenv("REVISIT_URL", fake.url)
        yield fake


@pytest.fixture
def nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """REVISIT_URL names an address where nobody listens."""
    monkeypatch.setenv("REVISIT_URL", "http://127.0.0.1:9")
