"""Images are described as when recorded."""

import pytest

from tests.golden.comparing import EXACT, ROUNDED, differences
from tests.golden.descriptions import DESCRIBED
from tests.golden.gallery import Gallery
from tests.golden.record import Golden


@pytest.mark.parametrize("name", DESCRIBED)
def test_an_image_is_described_as_it_was(gallery: Gallery, golden: Golden, exact: bool, name: str) -> None:
    described = gallery.described(*DESCRIBED[name])
    assert list(differences(golden["descriptions"][name], described, EXACT if exact else ROUNDED)) == []


def test_an_image_is_described_the_same_again(gallery: Gallery) -> None:
    assert gallery.described("town", "lane") == gallery.described_again("town", "lane")
