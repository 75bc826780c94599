"""Floors of a building look alike, but for signs, numbers and posters."""

from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.datasets import pairs
from scenes import LABELS, Building, building
from scenes.__main__ import main
from scenes.building import KINDS

SMALL = (160, 120)
NOTICEABLE = 24
"""Difference of a channel that grain does not make."""


def changed(one: Building, spot: int, floors: tuple[int, int]) -> np.ndarray:
    """Which pixels differ between two floors at the same spot."""
    first, second = (one.view(floor, spot)[0].astype(int) for floor in floors)
    return np.asarray(np.abs(first - second).max(axis=2) > NOTICEABLE)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_building_is_the_same_each_time(kind: str) -> None:
    def images() -> list[np.ndarray]:
        one = building(3, floors=1, spots=2, kind=kind, size=SMALL)  # type: ignore[arg-type]
        return [shot.image for shot in (*one.enrolments(), *one.queries(), *one.unknown())]

    for first, second in zip(images(), images(), strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_building_is_one_view_of_each_spot_and_queries_from_elsewhere(kind: str) -> None:
    one = building(1, floors=2, spots=3, kind=kind, size=SMALL)  # type: ignore[arg-type]
    spots = [(floor, spot) for floor in (1, 2) for spot in (1, 2, 3)]

    enrolled, queries, unknown = list(one.enrolments()), list(one.queries(2)), list(one.unknown())

    assert [(floor, spot) for floor, spot, _ in enrolled] == spots
    assert [(floor, spot) for floor, spot, _ in queries] == [place for place in spots for _ in range(2)]
    assert [(floor, spot) for floor, spot, _ in unknown] == [(one.unknown_floor, spot) for spot in (1, 2, 3)]
    assert {shot.image.shape for shot in (*enrolled, *queries, *unknown)} == {(120, 160, 3)}
    for view, query in zip(enrolled, queries[::2], strict=True):
        assert np.abs(view.image.astype(int) - query.image).mean() > 4


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("seed", [1, 2])
def test_two_floors_differ_in_few_pixels_and_always_in_some(kind: str, seed: int) -> None:
    one = building(seed, floors=3, kind=kind)  # type: ignore[arg-type]

    for spot in (1, 4, 6):
        for floors in ((1, 2), (3, one.unknown_floor)):
            assert 0.001 < changed(one, spot, floors).mean() < 0.08, (spot, floors)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_walls_and_doors_are_the_same_on_all_floors(kind: str) -> None:
    one = building(2, floors=2, kind=kind)  # type: ignore[arg-type]

    pixels, labels = one.view(1, 2)
    above, labels_above = one.view(2, 2)

    bare = (labels == labels_above) & ~np.isin(labels, [LABELS.index(name) for name in ("sign", "tree")])
    assert bare.mean() > 0.85
    assert (np.abs(pixels.astype(int) - above).max(axis=2)[bare] > NOTICEABLE).mean() < 0.01


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_signs_differ_where_there_are_signs(kind: str) -> None:
    one = building(1, floors=2, kind=kind)  # type: ignore[arg-type]
    differs = changed(one, 1, (1, 2))

    signs = one.view(1, 1)[1] == LABELS.index("sign")

    assert differs[signs].mean() > 20 * differs[~signs].mean()


def test_each_step_is_another_view() -> None:
    one = building(1, size=SMALL)

    views = [one.view(1, spot)[0].astype(int) for spot in range(1, 7)]

    assert min(np.abs(a - b).mean() for a, b in pairwise(views)) > 8


def test_other_seeds_are_other_buildings() -> None:
    one, other = (building(seed, size=SMALL).view(1, 1)[0].astype(int) for seed in (1, 2))

    assert np.abs(one - other).mean() > 15


def test_the_floor_that_is_not_enrolled_has_its_own_number() -> None:
    one = building(1, floors=3)

    assert one.unknown_floor == 4
    with pytest.raises(ValueError, match="no floor 5"):
        one.view(5, 1)


@pytest.mark.parametrize("wrong", [{"floors": 0}, {"spots": 0}, {"kind": "tower"}])
def test_impossible_buildings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="kinds are"):
        building(1, **wrong)  # type: ignore[arg-type]


def test_a_building_is_written_as_the_pairs_that_evaluation_reads(tmp_path: Path) -> None:
    assert main([str(tmp_path), "--floors", "2", "--spots", "2", "--queries", "2", "--kind", "lobby"]) == 0

    (dataset,) = pairs.read(tmp_path)

    assert [path.name for path in dataset.database] == [f"floor{f}-spot0{s}-1.jpg" for f in (1, 2) for s in (1, 2)]
    assert [right.tolist() for right in dataset.positives] == [[i // 2] for i in range(8)]
    assert len(list((tmp_path / "unknown").iterdir())) == 4
    assert cv2.imread(str(dataset.queries[0])).shape == (480, 640, 3)
