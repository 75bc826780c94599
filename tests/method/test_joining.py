"""Decisions of several searches become one."""

from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from schemas.comparisons import MapLevels
from worker.method.calibration import Verdict
from worker.method.decision import Decision, PlaceProbability
from worker.method.features import PRIOR, expected_levels
from worker.method.joining import Joined, join, pooled
from worker.method.reasons import EMPTY, SURE, Reason

LEVELS = MapLevels(compared=1000, level=0.2, gap=0.02, others=1000)
THRESHOLD, AMBIGUOUS = 0.9, 0.4
WEAK = Reason("weak", "nothing stands out", "enrol more")


def said(*probabilities: float) -> Decision:
    """What a search says whose places have these probabilities, best first."""
    if not probabilities:
        return Decision("no_match", 0.0, EMPTY, 0.97, THRESHOLD, LEVELS)
    best = probabilities[0]
    status: Verdict = "matched" if best >= THRESHOLD else "ambiguous" if best >= AMBIGUOUS else "no_match"
    places = tuple(PlaceProbability(p, (i,)) for i, p in enumerate(probabilities))
    reason = SURE if status == "matched" else WEAK
    return Decision(status, best, reason, 0.97, THRESHOLD, LEVELS, places, probabilities)


@st.composite
def decisions(draw: st.DrawFn) -> Decision:
    """Of a map with up to four places, as `decide` makes them: each takes a share of what those before it left."""
    left, found = 1.0, []
    for share in draw(st.lists(st.floats(0, 1), max_size=4)):
        found.append(left * share)
        left *= 1 - share
    return said(*sorted(found, reverse=True))


def everything(joined: Joined) -> float:
    return joined.nowhere + sum(place.probability for part in joined.parts for place in part.places)


def test_one_map_says_what_it_says() -> None:
    alone = said(0.95, 0.02)
    assert join([alone]) == Joined((alone,), 0, alone, None, alone.nowhere)


def test_a_place_that_one_map_alone_knows_stays_matched() -> None:
    joined = join([said(0.05, 0.01), said(0.96), said()])
    assert (joined.leading, joined.decision.status, joined.decision.reason.code) == (1, "matched", "sure")
    assert joined.rival is None
    assert joined.decision.confidence == pytest.approx(0.96 / 0.04 / (1 + 0.06 / 0.94 + 0.96 / 0.04))


def test_two_maps_that_are_equally_sure_are_look_alikes() -> None:
    joined = join([said(0.93), said(0.96)])
    assert (joined.leading, joined.rival) == (1, 0)
    assert (joined.decision.status, joined.decision.reason.code) == ("ambiguous", "look-alike")
    assert joined.parts[0].confidence + joined.parts[1].confidence > 0.97


def test_two_maps_that_are_certain_share_the_certainty() -> None:
    joined = join([said(1.0), said(1.0)])
    assert [part.confidence for part in joined.parts] == pytest.approx([0.5, 0.5])
    assert joined.decision.status == "ambiguous"


def test_no_map_knows_it() -> None:
    joined = join([said(0.2), said(0.3), said()])
    assert (joined.leading, joined.decision.status, joined.decision.reason) == (1, "no_match", WEAK)


def test_maps_without_views_say_so() -> None:
    joined = join([said(), said()])
    assert (joined.decision.status, joined.decision.reason, joined.nowhere) == ("no_match", EMPTY, 1.0)


@given(st.lists(decisions(), min_size=1, max_size=5))
def test_probabilities_sum_to_1(several: list[Decision]) -> None:
    assert everything(join(several)) == pytest.approx(1, abs=2e-6)


@given(st.lists(decisions(), min_size=1, max_size=4), decisions())
def test_another_map_never_makes_a_place_likelier(several: list[Decision], other: Decision) -> None:
    before, after = join(several), join([*several, other])
    for old, new in zip(before.parts, after.parts, strict=False):
        assert new.confidence <= old.confidence + 1e-9
    assert after.nowhere <= before.nowhere + 2e-6


@given(st.lists(decisions(), min_size=1, max_size=4))
def test_an_empty_map_changes_nothing(several: list[Decision]) -> None:
    before, after = join(several), join([*several, said()])
    assert after.decision.status == before.decision.status
    assert after.decision.confidence == pytest.approx(before.decision.confidence, abs=2e-6)


@given(st.lists(decisions(), min_size=2, max_size=4))
def test_an_answer_is_never_surer_than_its_map_alone(several: list[Decision]) -> None:
    joined = join(several)
    alone = several[joined.leading]
    order = ("no_match", "ambiguous", "matched")
    assert joined.decision.confidence <= alone.confidence + 1e-9
    if joined.decision.status == "matched":
        assert alone.status == "matched"
    assert order.index(joined.decision.status) <= max(order.index(one.status) for one in several)


def test_levels_of_several_maps_are_means_over_their_compared_views() -> None:
    one, two = MapLevels(compared=30, level=0.2, gap=0.02, others=29), MapLevels(10, 0.6, 0.01, 9)
    both = pooled([one, two])
    assert (both.compared, both.others) == (40, 38)
    assert [both.level, both.gap] == pytest.approx([0.3, 0.0175])
    assert pooled([one]) is one
    known = replace(one, own=0.8, paired=3)
    assert pooled([known, two]).own == pytest.approx(0.8)  # where no place has two views, none tells
    assert pooled([known, replace(two, own=0.4, paired=1)]).own == pytest.approx(0.7)
    assert pooled([MapLevels(), MapLevels()]) == MapLevels()


def test_maps_that_know_of_no_lead_say_nothing_of_leads() -> None:
    """One of two places, many views of each, and one that was made a moment ago, beside a map of many places."""
    many = MapLevels(compared=20, level=0.3, gap=0.05, others=19, breadth=3.0)
    two, new = MapLevels(compared=180, level=0.3, gap=0.0, others=90), MapLevels()
    for others in ([two], [new], [two, new]):
        together = pooled([*others, many])
        assert (together.gap, together.breadth) == (0.05, 3.0)
        assert expected_levels(together).gap >= expected_levels(PRIOR).gap
    assert pooled([two, two]) == replace(two, compared=360, others=180)
    assert pooled([many, replace(many, gap=0.01, breadth=1.0)]).breadth == pytest.approx(2.0)
