"""Fixtures of the golden tests: one gallery of maps, the expected values, the tolerance."""

from collections.abc import Iterator

import pytest

from tests.golden.comparing import CLOSE, EXACT, SIMILAR, Tolerance, differences
from tests.golden.descriptions import DESCRIBED
from tests.golden.gallery import Gallery
from tests.golden.record import Golden, read
from tests.small_images import enlarging_as_the_service_does


@pytest.fixture(scope="module", autouse=True)
def _small_images_too() -> Iterator[None]:
    """Nothing is spared here, of small images either."""
    with enlarging_as_the_service_does():
        yield


@pytest.fixture(scope="session")
def gallery(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gallery]:
    with Gallery(tmp_path_factory.mktemp("golden")) as gallery:
        yield gallery


@pytest.fixture(scope="session")
def golden() -> Golden:
    return read()


@pytest.fixture(scope="session")
def exact(pytestconfig: pytest.Config) -> bool:
    return bool(pytestconfig.getoption("golden_exact"))


@pytest.fixture(scope="module")
def tolerance(gallery: Gallery, golden: Golden, exact: bool, _small_images_too: None) -> Tolerance:
    """Tolerance of answers: where descriptions equal the recorded ones, only the ranking can make answers differ.

    It makes maps, which a session's fixture would do before `_small_images_too`.
    """
    if exact:
        return EXACT
    described = {name: gallery.described(*of) for name, of in DESCRIBED.items()}
    return SIMILAR if any(differences(golden["descriptions"], described, EXACT)) else CLOSE
