"""Maps and queries of known and unknown places, on walks and separate places small enough to count by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.datasets.dataset import Dataset
from lab.datasets.hold_out import hold_out
from lab.datasets.layout import layout, with_attributes
from lab.datasets.protocols import (
    Trial,
    blocks,
    elsewhere,
    halves,
    site,
    small_maps,
    unknown,
    whole,
    without_parts,
)
from tests.lab.datasets.drawn import image


def walk(root: Path = Path("street_day"), count: int = 100, tolerance: int = 1) -> Dataset:
    """Query i shows the place of frame i, give or take."""
    positives = tuple(
        np.arange(max(0, i - tolerance), min(count, i + tolerance + 1), dtype=np.int64) for i in range(count)
    )
    database, queries = (tuple(root / f / f"{i:03}.jpg" for i in range(count)) for f in ("d", "q"))
    return Dataset("walk", database, queries, positives, "+-1")


def floors(each: int = 30) -> Dataset:
    """Three floors; each query lies between two frames, and no two queries share one."""
    names = [f"floor{f}_{i:03}.jpg" for f in (1, 2, 3) for i in range(each)]
    count = 3 * each // 2
    positives = tuple(np.array([2 * i, 2 * i + 1], np.int64) for i in range(count))
    queries = tuple(Path("office/q") / f"{i}.jpg" for i in range(count))
    return Dataset("floors", tuple(Path("office/d") / n for n in names), queries, positives, "+-1")


def seasons() -> Dataset:
    """Four places, two images of each in the database and three to query with; the last place is never queried."""
    database = tuple(Path("park/d") / f"place{p}_{i}.jpg" for p in (4, 3, 2, 1) for i in (1, 2))
    queries = tuple(Path("park/q") / f"place{p}_{i}.jpg" for p in (3, 2, 1) for i in (3, 4, 5))
    positives = tuple(np.array([2 * p, 2 * p + 1], np.int64) for p in (1, 2, 3) for _ in range(3))
    return Dataset("seasons", database, queries, positives, "the same place")


def numbers(trial: Trial, kind: str) -> list[int]:
    return [int(q.image.stem) for q in trial.queries if q.kind == kind]


def test_frames_that_overlap_are_a_walk_whose_tolerance_is_five_metres() -> None:
    found = layout(walk(tolerance=2))
    assert (found.walk, found.named, found.tolerance) == (True, False, 2)
    positions = with_attributes(walk(tolerance=2)).database_positions
    assert positions is not None
    assert positions[:3].tolist() == [[0, 0], [2.5, 0], [5, 0]]


def test_pairs_of_frames_out_of_a_series_are_a_walk_with_parts() -> None:
    found = layout(floors())
    assert (found.walk, found.tolerance) == (True, 1)
    assert np.bincount(found.part).tolist() == [30, 30, 30]
    positions = with_attributes(floors()).database_positions
    assert positions is not None
    assert positions[31].tolist() == [31 * 5, 1000]
    assert found.near(np.array([29]), 2).tolist() == [27, 28, 29]  # not the first of the next floor


def test_separate_places_get_names_from_the_truth() -> None:
    found = with_attributes(seasons())
    assert found.places == ("place 1", "place 2", *(f"place {p}" for p in (3, 4, 5) for _ in range(2)))
    assert found.database_positions is None
    assert layout(seasons()).tolerance == 0


def test_single_right_answers_are_places_of_their_own() -> None:
    found = layout(walk(count=5, tolerance=0))
    assert found.named
    assert found.unit.tolist() == [0, 1, 2, 3, 4]


def test_what_a_set_says_of_itself_stays_and_nothing_is_made_up() -> None:
    positions = np.arange(200.0).reshape(100, 2)
    said = replace(walk(), database_positions=positions)
    assert with_attributes(said) is said
    scattered = replace(
        walk(count=6), positives=tuple(np.array(p, np.int64) for p in ([0, 3], [1, 4], [3, 5], [0], [1], [2]))
    )
    assert not layout(scattered).walk
    assert with_attributes(scattered) is scattered


def test_names_of_places_are_one_an_image_and_go_with_their_images() -> None:
    with pytest.raises(ValueError, match="1 names of places for 8 images"):
        replace(seasons(), places=("here",))
    held_out = hold_out(with_attributes(seasons()), 0.3, np.random.default_rng(0))
    assert held_out.places is not None
    assert len(held_out.places) == len(held_out.database) < 8
    named = dict(zip(seasons().database, with_attributes(seasons()).places or (), strict=True))
    assert [named[path] for path in held_out.database] == list(held_out.places)


def test_halves_of_a_walk_by_hand() -> None:
    first, second = halves(walk(), stretches=4, guard=2)
    assert first.enrolled.tolist() == [*range(25), *range(50, 75)]
    assert second.enrolled.tolist() == [*range(25, 50), *range(75, 100)]
    # Right answers are i - 1 .. i + 1 and the guard band two more: all of i - 3 .. i + 3 on one side of a cut.
    clear = [*range(22), *range(28, 47), *range(53, 72), *range(78, 100)]
    known = [i for i in clear if i < 25 or 50 <= i < 75]
    assert numbers(first, "known") == numbers(second, "same-site") == known
    assert numbers(first, "same-site") == numbers(second, "known") == sorted({*clear} - {*known})
    wider, _ = halves(walk(), stretches=4, guard=3)
    assert len(wider.queries) == len(first.queries) - 6


def test_halves_of_separate_places_need_no_guard() -> None:
    first, second = halves(seasons(), stretches=2)
    assert [q.kind for q in first.queries] == ["known"] * 6 + ["same-site"] * 3
    assert [q.kind for q in second.queries] == ["same-site"] * 6 + ["known"] * 3
    assert sorted([*first.enrolled, *second.enrolled]) == list(range(8))


def test_a_short_walk_is_halved_once() -> None:
    first, _ = halves(walk(count=40), stretches=4, guard=2)  # stretches of 10, a band of 3 on either side
    assert first.enrolled.tolist() == list(range(20))


def test_cuts_lie_among_what_is_queried() -> None:
    """Distractors that no query shows do not take a half for themselves."""
    plain = walk(count=100)
    shown = replace(plain, queries=plain.queries[60:], positives=plain.positives[60:])  # of frames 59 to 99
    first, second = halves(shown, stretches=2)
    assert first.enrolled.tolist() == list(range(80))
    assert len(numbers(first, "known")) == 17
    assert numbers(first, "same-site") == numbers(second, "known")


def test_halves_need_places() -> None:
    with pytest.raises(ValueError, match="3 places do not make 4 stretches"):
        halves(seasons(), stretches=4)
    with pytest.raises(ValueError, match="3 stretches in two halves"):
        halves(walk(), stretches=3)


def test_a_floor_is_left_out() -> None:
    trials = without_parts(floors())
    assert [len(t.enrolled) for t in trials] == [60, 60, 60]
    assert numbers(trials[1], "same-site") == list(range(15, 30))
    assert numbers(trials[1], "known") == [*range(15), *range(30, 45)]
    assert without_parts(walk()) == without_parts(seasons()) == []


def test_small_maps_know_a_stretch() -> None:
    [found] = small_maps(walk(), 10, 1, np.random.default_rng(0))
    assert found.protocol == "10 places"
    start = int(np.random.default_rng(0).integers(100))
    assert start < 87  # or what follows would have to go around the end
    assert found.enrolled.tolist() == list(range(start, start + 10))
    assert numbers(found, "known") == list(range(start - 1, start + 11))
    near = range(start - 3, start + 13)
    assert numbers(found, "same-site") == [i for i in range(100) if i not in near]


def test_small_maps_go_around_the_end_or_take_places_from_everywhere() -> None:
    around = small_maps(walk(), 60, 5, np.random.default_rng(0))
    assert {len(t.enrolled) for t in around} == {60}
    assert any({0, 99} <= set(t.enrolled.tolist()) for t in around)
    [spread] = small_maps(walk(), 10, 1, np.random.default_rng(0), spread=True)
    assert len(spread.enrolled) == 10
    assert np.ptp(spread.enrolled) > 20


def test_a_place_is_drawn_with_all_its_images() -> None:
    [one] = small_maps(seasons(), 1, 1, np.random.default_rng(1), whole(seasons()).queries[:0])
    assert one.protocol == "1 place"
    assert len(one.enrolled) in (1, 2)
    found = small_maps(with_attributes(seasons()), 3, 4, np.random.default_rng(0))
    assert {len(t.queries) for t in found} == {9}  # separate places: every query is judged


def test_no_map_has_more_places_than_there_are() -> None:
    rng = np.random.default_rng(0)
    assert small_maps(walk(), 101, 3, rng) == []
    [everything] = small_maps(walk(), 100, 3, rng)
    assert len(everything.enrolled) == 100


def test_queries_of_other_sites_come_once_and_never_from_the_same_site() -> None:
    here, night, there = walk(Path("street_day")), walk(Path("street_night")), walk(Path("forest"), 12)
    assert (site(here), site(night), site(there)) == ("street", "street", "forest")
    found = elsewhere(here, [here, night, there, there])
    assert [q.image for q in found] == list(there.queries)
    assert {q.kind for q in found} == {"other-site"}
    assert whole(here, found).queries[100:] == found


def test_blocks_are_runs_of_a_walk_or_places() -> None:
    assert blocks(walk())[9:11] == ["street_day/q 0", "street_day/q 1"]
    assert len(set(blocks(walk()))) == 10
    assert len(set(blocks(seasons()))) == 3
    assert blocks(seasons())[0] == blocks(seasons())[2] != blocks(seasons())[3]


def test_the_folder_of_unknown_places(tmp_path: Path) -> None:
    assert unknown(walk(tmp_path)) == ()
    for i in range(11):
        image(tmp_path / "unknown" / f"{i}.jpg")
    found = unknown(walk(tmp_path))
    assert {q.kind for q in found} == {"same-site"}
    assert [q.block[-1] for q in found] == ["0"] * 10 + ["1"]
    assert whole(walk(tmp_path)).queries[100:] != ()


def test_a_query_without_right_answers_is_no_proof_of_an_unknown_place() -> None:
    nobody = replace(walk(), positives=(np.zeros(0, np.int64), *walk().positives[1:]))
    assert len(whole(nobody).queries) == 99
