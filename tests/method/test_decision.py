"""Probabilities of places, one verdict, and the reason for it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from schemas.comparisons import KnownView, MapLevels
from schemas.records import Position
from worker.method.calibration import Calibration, Logistic
from worker.method.decision import Decision, blame_image, decide, of_nothing, shared
from worker.method.evidence import Ranking
from worker.method.features import PRIOR, USUAL_OWN, expected_levels, features, floor, own_share, tells_apart
from worker.method.impostors import ImpostorEvidence
from worker.method.places import Places

LEVELS = MapLevels(compared=1000, level=0.2, gap=0.02, others=1000)
CALIBRATION = Calibration(
    ("gap", "level", "breadth", "either"),
    Logistic(np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.25, 0.25, 0.5, 0.25]), np.array([1.0, 1.0, 1.0, 1.0]), 0.0),
    np.array([0.5, 0.97, 0.99]),
    np.array([0.5, 0.9, 0.95]),
    np.array([0.9, 0.5, 0.3]),
)


def ranking(
    scores: Sequence[float],
    known: Mapping[int, KnownView] | None = None,
    reranked: int = 100,
    cells: Mapping[int, Sequence[float]] | None = None,
    inliers: int | Sequence[int] = -1,
    impostors: ImpostorEvidence | None = None,
) -> Ranking:
    """Views with the sequence numbers 0, 1, ... and these scores, best first; with so many inliers, or unverified."""
    n = len(scores)
    places = Places({i: (known or {}).get(i, KnownView()) for i in range(n)}, 5.0)
    rivals = [i for i in range(1, min(n, reranked)) if places.apart(0, i)]
    return Ranking(
        np.arange(n),
        np.arange(n),
        np.array(scores, np.float32),
        {},
        np.broadcast_to(inliers, n),
        np.broadcast_to(inliers, n),
        {},
        min(n, reranked),
        places,
        min(len(places.group(rivals)), 10),
        tuple(rivals),
        {i: np.array(weights, np.float32) for i, weights in (cells or {}).items()},
        (),
        lambda index: pytest.fail("a decision needs no more evidence"),
        impostors,
    )


def named(*names: str | None) -> dict[int, KnownView]:
    return {i: KnownView(name) for i, name in enumerate(names)}


def decided(
    scores: Sequence[float],
    known: Mapping[int, KnownView] | None = None,
    levels: MapLevels = LEVELS,
    precision: float = 0.97,
    searched: int = 100,
    cells: Mapping[int, Sequence[float]] | None = None,
    inliers: int | Sequence[int] = -1,
    impostors: ImpostorEvidence | None = None,
) -> Decision:
    shown = ranking(scores, known, cells=cells, inliers=inliers, impostors=impostors)
    return decide(shown, levels, CALIBRATION, precision, searched=searched)


def test_features_by_hand() -> None:
    usual, alone = MapLevels(10, 0.3, 0.02), {"own": 0.0, "either": 0.0}
    assert features(0.5, 0.3, usual) == {"gap": pytest.approx(np.log(6)), "level": 0.0, "breadth": 0.0, **alone}
    assert features(0.14, 0.2, usual) == {"gap": 0.0, "level": pytest.approx(np.log(0.5)), "breadth": 0.0, **alone}
    broad = replace(usual, breadth=2.0)
    assert features(0.5, 0.3, broad, 6.0)["breadth"] == pytest.approx(np.log(3))
    some = features(0.5, 0.3, broad, 6.0, least=0.4875)  # of the lead of .2 a sixteenth is left, of its breadth half
    assert some["gap"] == pytest.approx(np.log1p(0.0125 / 0.04))
    assert some["breadth"] == pytest.approx(np.log(2))
    assert features(0.3, 0.5, broad, 6.0)["breadth"] == 0
    both = features(0.5, 0.3, broad, 6.0, own_weight=1.0)
    assert both["either"] == pytest.approx((np.log(3) ** 2 + (3 * both["own"]) ** 2) ** 0.5)
    assert some["either"] == some["breadth"]


def test_a_score_that_views_of_one_place_get_is_evidence_unless_another_place_shows_the_same_things() -> None:
    usual = MapLevels(10, 0.3, 0.02, own=0.78)

    def own(score: float, inliers: int | None, others: int = 10, rival: float = 0.3) -> float:
        return features(score, rival, usual, own_weight=tells_apart(inliers, others))["own"]

    half = 1 - np.log(2)
    assert own(0.38, 0) == pytest.approx(half)  # half of what they get
    assert [own(0.38, 10), own(0.38, 30)] == pytest.approx([half / 2, half / 4])
    assert own(0.7, 0) == own(0.95, 0) == pytest.approx(0.5)
    assert own(0.2, 0) == 0  # a fourth is nothing
    assert own(0.2, 0, rival=0.14) == pytest.approx(1 + np.log(0.22 / 0.8) + np.log(2))  # unless all get half of it
    assert own(0.78, None) == 0  # nothing was verified: nobody knows whether another place shows the same
    assert own(0.78, 0, others=0) == 0
    assert own(0.38, 0, others=20) == own(0.38, 0) > own(0.38, 0, others=5) > own(0.38, 0, others=1)


def test_what_views_of_one_place_get_is_taken_from_other_maps_while_few_are_known() -> None:
    few, many = (expected_levels(MapLevels(100, 0.3, 0.02, 99, own=0.9, paired=n)).own for n in (4, 4000))
    assert expected_levels(MapLevels(100, 0.3, 0.02, 99)).own == USUAL_OWN
    assert few == pytest.approx((0.9 + USUAL_OWN) / 2)
    assert many == pytest.approx(0.9, abs=0.001)


def test_rooms_enrolled_with_a_view_of_each_wall_tell_nothing_of_what_views_of_one_place_get() -> None:
    walls, one_view_each = replace(LEVELS, own=0.25, paired=1000), LEVELS
    unknown_room, known_room = [0.25, 0.19], [0.5, 0.19]
    assert decided(unknown_room, levels=walls, inliers=0).status != "matched"
    for seen in (unknown_room, known_room):
        first, second = (decided(seen, levels=levels, inliers=0) for levels in (walls, one_view_each))
        assert first.features == second.features


def test_a_map_without_comparisons_is_taken_for_one_like_others_and_moves_over_to_its_own() -> None:
    new = expected_levels(MapLevels())
    assert (new.level, new.gap) == (PRIOR.level, PRIOR.gap)
    assert new.breadth == PRIOR.breadth
    assert expected_levels(MapLevels(4000, 0.6, 0.06, others=4000)).breadth == PRIOR.breadth  # compared before 0017
    assert expected_levels(MapLevels(4000, 0.6, 0.06, others=4000, breadth=5.0)).breadth == pytest.approx(5, abs=0.01)
    few, many = (expected_levels(MapLevels(n, 0.6, 0.06, others=n)) for n in (4, 4000))
    assert few.level == pytest.approx((0.8 * 0.6 + 4 * PRIOR.level) / 4.8)  # 4 of the 20 other views that are enough
    assert many.level == pytest.approx(0.6, abs=0.001)
    assert many.gap == pytest.approx(0.06, abs=0.001)


def test_a_map_of_two_places_leaves_it_to_other_maps_by_what_wrong_answers_lead() -> None:
    """A view of the one has the other as its best wrong answer, and nothing that this could lead over."""
    assert expected_levels(MapLevels(60, 0.3, 0.0, others=30)).gap == PRIOR.gap


def test_what_stands_out_from_what_wrong_answers_get_is_matched() -> None:
    outstanding = decided([0.6, 0.2, 0.19])
    assert (outstanding.status, outstanding.reason.code) == ("matched", "sure")
    assert outstanding.confidence > 0.95


def test_the_same_scores_in_a_map_where_wrong_answers_get_more_are_not() -> None:
    elsewhere = decided([0.6, 0.5, 0.49], levels=MapLevels(1000, 0.6, 0.08, 1000))
    assert elsewhere.status == "no_match"
    assert elsewhere.reason.code == "weak"


def test_another_place_that_is_nearly_as_good_is_named_as_look_alike() -> None:
    twins = decided([0.6, 0.58, 0.2], named("floor 1", "floor 2", "cellar"))
    assert twins.status != "matched"
    assert twins.reason.code == "look-alike"


def test_a_place_that_gets_what_wrong_places_get_is_no_look_alike() -> None:
    places = named(*map(str, range(12)))
    usual, more = (decided([0.28, score, *[0.1] * 10], places) for score in (0.195, 0.22))
    assert (usual.status, usual.reason.code) == ("ambiguous", "weak")
    assert more.reason.code == "look-alike"


def test_floors_that_the_map_takes_for_one_stand_out_together() -> None:
    known = {0: KnownView("floor 1"), 1: KnownView("floor 2", same_spot=frozenset({0})), 2: KnownView("cellar")}
    together = decided([0.6, 0.6, 0.2], known)
    assert (together.status, together.reason.code) == ("ambiguous", "look-alike")
    assert together.confidence < 0.5
    assert decided([0.6, 0.6, 0.55], known).status == "no_match"

    # Whoever stands at one of them is not lost: each is as probable as the other, and hardly anything is left for none.
    one, other = (place.probability for place in together.places[:2])
    assert one == pytest.approx(other)
    assert together.nowhere < 0.1


@pytest.mark.parametrize(("first", "each"), [(0.1, [0.3, 0.3, 0.3]), (0.5, [0.5, 0.2, 0.2]), (0.9, [0.9, 0.0, 0.0])])
def test_look_alikes_have_what_the_best_one_leaves(first: float, each: list[float]) -> None:
    left, found = 1.0, []
    for share in shared(first, 0.9, 3):
        found.append(left * share)
        left *= 1 - share
    assert found == pytest.approx(each)
    assert shared(0.2, 1.0, 2) == pytest.approx([0.5, 1.0])


@pytest.mark.parametrize("count", range(2, 11))
@pytest.mark.parametrize("first", [0.0, 0.3, 0.999, 1.0])
def test_certain_look_alikes_leave_nothing_below_0(first: float, count: int) -> None:
    assert all(0 <= given <= 1 for given in shared(first, 1.0, count))


def test_of_two_leads_as_large_the_broader_one_is_surer() -> None:
    everywhere, one_spot = ([0.02, 0.02, 0.02, 0.02], [0.08, 0.0, 0.0, 0.0])
    broad, narrow = (decided([0.3, 0.26], cells={0: lead, 1: [0.0] * 4}) for lead in (everywhere, one_spot))
    assert broad.confidence > narrow.confidence
    assert broad.features["gap"] == narrow.features["gap"]


def test_what_images_of_no_place_get_is_no_evidence() -> None:
    apart = named("lane", "mill")
    sure = decided([0.6, 0.2], apart, impostors=ImpostorEvidence(0.2, ()))
    like_a_wall = decided([0.6, 0.2], apart, impostors=ImpostorEvidence(0.58, ()))
    look_alike = decided([0.6, 0.58], apart, impostors=ImpostorEvidence(0.2, ()))
    weak = decided([0.21, 0.2], apart, impostors=ImpostorEvidence(0.2, ()))

    assert sure == decided([0.6, 0.2], apart)
    assert like_a_wall.status == "no_match"
    assert like_a_wall.confidence == pytest.approx(decided([0.6, 0.58], apart).confidence, rel=1e-4)  # without cells
    assert like_a_wall.reason.code == "weak"
    assert "pictures that show no place" in like_a_wall.reason.detail
    assert look_alike.reason.code == "look-alike"
    assert "pictures that show no place" not in weak.reason.detail


def test_a_place_that_looks_like_places_elsewhere_is_no_match_and_is_told_so() -> None:
    apart = named("park", "mill")
    like_other_parks = decided([0.6, 0.2], apart, impostors=ImpostorEvidence(0.58, (), elsewhere=True))
    sure = decided([0.6, 0.2], apart, impostors=ImpostorEvidence(0.2, (), elsewhere=True))

    assert sure == decided([0.6, 0.2], apart)
    assert (like_other_parks.status, like_other_parks.reason.code) == ("no_match", "weak")
    assert "hardly from places elsewhere" in like_other_parks.reason.detail


def test_a_lead_that_is_narrow_over_a_image_of_no_place_is_narrow() -> None:
    cells = {0: [0.5] * 100, 1: [0.1] * 100}
    spots = ImpostorEvidence(0.1, (np.array([0.0] * 20 + [0.6] * 80, np.float32),))
    broad, narrow = (decided([0.6, 0.2], cells=cells, impostors=one) for one in (None, spots))
    assert narrow.features["breadth"] < broad.features["breadth"]
    assert narrow.confidence < broad.confidence


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=12).map(lambda scores: sorted(scores, reverse=True)),
    st.floats(0, 1),
    st.floats(0, 1),
    st.integers(0, 2**32),
)
def test_the_more_images_of_no_place_get_the_less_sure_is_the_answer(
    scores: list[float], one: float, other: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    cells = {i: rng.exponential(score + 0.01, 20).astype(np.float32).tolist() for i, score in enumerate(scores[:3])}
    shown = tuple(rng.exponential(0.3, (2, 20)).astype(np.float32))
    less, more = sorted((one, other))

    without, few = (
        decided(scores, cells=cells, impostors=these) for these in (None, ImpostorEvidence(less, shown[:1]))
    )
    many = decided(scores, cells=cells, impostors=ImpostorEvidence(more, shown))

    assert many.confidence <= few.confidence <= without.confidence


def test_another_view_of_the_same_place_is_no_rival() -> None:
    one = decided([0.6, 0.58, 0.2], named("hall", "hall", "cellar"))
    assert one.status == "matched"
    assert [place.views for place in one.places] == [(0, 1), (2,)]


SeenView = tuple[float, tuple[int, ...], int]
"""A score, what agrees at each of three cells, and inliers."""

VIEWS = st.tuples(st.floats(0, 1), st.lists(st.integers(0, 9), min_size=3, max_size=3).map(tuple), st.integers(-1, 40))


@given(st.lists(VIEWS, min_size=1, max_size=6), st.lists(VIEWS, max_size=6), st.lists(VIEWS, max_size=6))
@example(
    own=[(0.25, (0, 0, 0), 0)], others=[(1.0, (0, 0, 0), 0)], more=[(0.0, (0, 0, 0), 0)]
)  # once spoke for the first
@example(
    own=[(0.5, (0, 0, 0), -1)],
    others=[(1.0, (0, 0, 1), -1), (0.97265625, (0, 0, 1), -1)],
    more=[(0.9765625, (0, 0, 0), -1)],
)
def test_more_views_of_a_place_never_lower_its_probability(
    own: list[SeenView], others: list[SeenView], more: list[SeenView]
) -> None:
    def probability(own: list[SeenView]) -> float:
        views = sorted([("here", *view) for view in own] + [(f"there {i}", *view) for i, view in enumerate(others)])
        views.sort(key=lambda view: -view[1])
        names, scores, cells, inliers = zip(*views, strict=True)
        answer = decided(scores, named(*names), cells=dict(enumerate(cells)), inliers=inliers)
        return sum(place.probability for place in answer.places if names[place.views[0]] == "here")

    assert probability(own + more) >= probability(own) - 1e-9


@given(st.lists(st.floats(0, 1), min_size=1, max_size=15), st.lists(st.sampled_from("abc"), min_size=15, max_size=15))
def test_probabilities_of_all_places_and_none_sum_to_one(scores: list[float], names: list[str]) -> None:
    answer = decided(sorted(scores, reverse=True), named(*names))
    probabilities = [place.probability for place in answer.places]
    assert sum(probabilities) + answer.nowhere == pytest.approx(1)
    assert min([*probabilities, answer.nowhere]) >= 0
    assert answer.confidence == probabilities[0]
    assert all(a >= b for a, b in zip(answer.confidences, answer.confidences[1:], strict=False))


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=40), st.lists(st.sampled_from("abcdef"), min_size=40, max_size=40)
)
def test_nothing_depends_on_how_many_views_are_shown(scores: list[float], names: list[str]) -> None:
    """Nor does the verdict over several maps: `joining` reads the probability of none."""
    views = ranking(sorted(scores, reverse=True), {i: KnownView(n if n > "c" else None) for i, n in enumerate(names)})
    few, many = (decide(views, LEVELS, CALIBRATION, 0.97, searched=100, shown=shown) for shown in (1, 40))
    assert (many.status, many.confidence, many.reason) == (few.status, few.confidence, few.reason)
    assert many.nowhere == pytest.approx(few.nowhere, abs=1e-9)
    assert [place.probability for place in many.places[: len(few.places)]] == [p.probability for p in few.places]
    assert sum(place.probability for place in many.places) + many.nowhere == pytest.approx(1)


def test_neighbours_far_down_do_not_make_the_verdict_another() -> None:
    """Ten views of one spot, then views along the path that are neither of it nor rivals."""
    known = {i: KnownView(position=Position(x=0.0 if i < 10 else 8.0, y=0.0)) for i in range(12)}
    views = ranking([*np.linspace(0.26, 0.25, 10), 0.1, 0.1], known)
    few, many = (decide(views, LEVELS, CALIBRATION, 0.97, searched=100, shown=shown) for shown in (1, 12))
    assert few.status == many.status == "no_match"


def test_who_wants_more_precision_gets_matched_less_often() -> None:
    scores = [0.35, *([0.2] * 30)]
    assert decided(scores, precision=0.9).status == "matched"
    assert decided(scores, precision=0.999).status == "ambiguous"


def test_what_stands_out_too_little_for_the_precision_is_not_said_to_stand_out_from_nothing() -> None:
    scores = [0.35, *([0.2] * 30)]
    elsewhere = MapLevels(1000, 0.6, 0.08, 1000)
    almost, nothing = decided(scores, precision=0.999), decided([0.6, 0.5, 0.49], levels=elsewhere)
    assert (almost.reason.code, nothing.reason.code) == ("weak", "weak")
    assert "not as sure as the precision asks for" in almost.reason.detail
    assert nothing.reason.detail.startswith("no place stands out")


def test_a_map_with_one_place_never_says_ambiguous() -> None:
    status = {decided([score, score], named("home", "home")).status for score in np.linspace(0, 1, 101)}
    assert status == {"matched", "no_match"}


def test_the_only_place_must_exceed_what_wrong_answers_get() -> None:
    assert decided([0.22], levels=LEVELS).status == "no_match"
    assert decided([0.6], levels=LEVELS).status == "matched"


def test_nothing_to_search_is_said() -> None:
    empty = decided([])
    assert (empty.status, empty.confidence, empty.reason.code, empty.nowhere) == ("no_match", 0.0, "empty", 1.0)


def test_too_few_views_and_a_poor_image_are_said() -> None:
    assert decided([0.21, 0.2], searched=2).reason.code == "few-views"
    dark = blame_image(decided([0.21, 0.2]), "the image is dark")
    assert (dark.reason.code, dark.reason.detail) == ("poor-picture", "the image is dark")
    assert blame_image(decided([0.6, 0.2]), "the image is dark").reason.code == "sure"
    assert blame_image(decided([]), "the image is dark").reason.code == "empty"
    assert blame_image(decided([0.21, 0.2]), None).reason.code == "weak"


def test_an_image_of_nothing_shows_none_of_the_places() -> None:
    nothing = of_nothing(decided([0.6, 0.2, 0.1]))
    assert (nothing.status, nothing.reason.code, nothing.confidence, nothing.nowhere) == (
        "no_match",
        "poor-picture",
        0,
        1,
    )
    assert nothing.confidences == (0, 0, 0)
    assert of_nothing(decided([])).reason.code == "empty"


def test_histograms_alone_decide_nothing_in_a_map_that_knows_whole_scores() -> None:
    alone = decide(ranking([0.9, 0.2]), LEVELS, CALIBRATION, 0.97, searched=100, measured_alike=False)
    assert alone.status != "matched"
    assert "histograms alone" in alone.reason.detail


def test_in_a_map_of_few_places_a_lead_over_the_other_few_is_not_enough() -> None:
    few, many = [0.28, 0.1], [0.28, *([0.1] * 30)]
    assert decided(few).status != "matched"
    assert decided(many).status == "matched"


def test_a_map_of_usual_size_decides_by_its_own_views() -> None:
    assert own_share(MapLevels()) == 0
    assert own_share(MapLevels(6, 0.3, 0.02, others=5)) < 0.5 < own_share(MapLevels(24, 0.3, 0.02, others=23))


def test_a_search_narrowed_down_in_a_map_that_knows_itself_is_judged_by_the_maps_own_level() -> None:
    known, new = (floor(2, levels) for levels in (LEVELS, MapLevels(0, 0.2, 0.02)))
    assert known == pytest.approx(LEVELS.level, abs=0.01)
    assert new > known + 0.1
    assert floor(10, LEVELS) == 0
