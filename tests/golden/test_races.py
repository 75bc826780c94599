"""A map may change during a query: the answer holds the remaining views, by one recipe, or is an error."""

import pytest

from tests.golden.adapter import MapOptions
from tests.golden.comparing import Tolerance, differences
from tests.golden.gallery import Gallery, condensed
from tests.golden.races import (
    BEFORE_FETCHES,
    FETCHES,
    FEWER_LABELS,
    OTHER,
    ROUNDS,
    changed_over_meanwhile,
    deleted_meanwhile,
)
from tests.golden.record import Golden


@pytest.mark.parametrize("stage", FETCHES)
def test_a_view_that_is_deleted_after_it_was_found_is_not_in_the_answer_and_leaves_no_trace(
    gallery: Gallery, golden: Golden, tolerance: Tolerance, stage: str
) -> None:
    answer, calm, reached = deleted_meanwhile(gallery, stage, 1)
    assert reached == 2
    assert answer == calm
    assert list(differences(golden["races"]["one deleted"], condensed(answer.evidence), tolerance)) == []


@pytest.mark.parametrize("stage", FETCHES)
def test_a_query_is_searched_five_times_before_it_is_given_up(
    gallery: Gallery, golden: Golden, tolerance: Tolerance, stage: str
) -> None:
    answer, calm, reached = deleted_meanwhile(gallery, stage, ROUNDS - 1)
    assert reached == ROUNDS
    assert answer == calm
    assert list(differences(golden["races"]["four deleted"], condensed(answer.evidence), tolerance)) == []


@pytest.mark.parametrize("stage", FETCHES)
def test_when_views_keep_being_deleted_the_query_is_refused(gallery: Gallery, stage: str) -> None:
    answer, calm, reached = deleted_meanwhile(gallery, stage, ROUNDS)
    assert answer.evidence == {"http_status": 503, "refused": "unavailable"}
    assert reached == ROUNDS
    assert calm.evidence["match.view"][0] == "strip 1"


@pytest.mark.parametrize("stage", BEFORE_FETCHES)
def test_when_the_map_changes_over_before_the_search_the_query_is_described_anew(gallery: Gallery, stage: str) -> None:
    answer, before, after = changed_over_meanwhile(gallery, stage, OTHER)
    assert before.recipe != after.recipe
    assert before.evidence != after.evidence
    assert answer == after


@pytest.mark.parametrize("stage", FETCHES)
@pytest.mark.parametrize("options", [OTHER, FEWER_LABELS], ids=["other graphs", "fewer labels"])
def test_when_the_map_changes_over_after_the_search_the_answer_is_by_the_recipe_it_began_with(
    gallery: Gallery, stage: str, options: MapOptions
) -> None:
    answer, before, after = changed_over_meanwhile(gallery, stage, options)
    assert before.recipe != after.recipe
    assert (answer.recipe, answer.evidence) == (before.recipe, before.evidence)  # of another map, at another revision
