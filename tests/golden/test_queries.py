"""Queries are answered as when recorded: every stage and every edge case of the cascade."""

import pytest

from tests.golden.cases import CASES
from tests.golden.comparing import Tolerance, differences
from tests.golden.gallery import Gallery
from tests.golden.maps import FACTS
from tests.golden.record import Golden


@pytest.mark.parametrize("name", CASES)
def test_a_query_is_answered_as_it_was(gallery: Gallery, golden: Golden, tolerance: Tolerance, name: str) -> None:
    assert list(differences(golden["answers"][name], gallery.answered(name), tolerance)) == []


@pytest.mark.parametrize("name", FACTS)
def test_a_map_and_its_views_say_of_themselves_what_they_did(
    gallery: Gallery, golden: Golden, tolerance: Tolerance, name: str
) -> None:
    assert list(differences(golden["maps"][name], gallery.map(name)[2], tolerance)) == []


def test_every_golden_value_has_a_query(golden: Golden) -> None:
    assert (set(golden["answers"]), set(golden["maps"])) == (set(CASES), set(FACTS))
