from collections.abc import Iterator

import pytest

from tests.cli.fake_service import FakeService, fake_service


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
