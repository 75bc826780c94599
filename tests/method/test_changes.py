"""What changed between two grids of cells: a thing that is gone, new or moved, and nothing where only the light did."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.description import Floats
from worker.description.describer import components
from worker.method import changes
from worker.method.lost_cells import PhotoCells
from worker.method.lost_regions import Region
from worker.method.unit_length import unit

ROWS, COLUMNS, CHANNELS = 40, 60, 24
EXTENT = (1.0, ROWS / COLUMNS)
SAME = np.array([[1.0, 0, 0], [0, 1, 0]])
FLOOR, CHAIR, CABINET, PERSON = range(4)

Box = tuple[slice, slice]
LEFT: Box = (slice(12, 22), slice(8, 18))
RIGHT: Box = (slice(12, 22), slice(40, 50))


def place(*things: tuple[Box, int], light: float = 0.0, shift: int = 0) -> PhotoCells:
    """A textured floor with things; `light` mixes noise into every cell, `shift` moves the camera by columns."""
    rng = np.random.default_rng(0)
    kinds = unit(rng.standard_normal((4, CHANNELS)))
    grain = rng.standard_normal((ROWS, COLUMNS + 20, CHANNELS)) * 0.12
    labels = np.full((ROWS, COLUMNS + 20), FLOOR)
    for (rows, columns), label in things:
        labels[rows, columns] = label
    cells = unit((kinds[labels] + grain)[:, shift : shift + COLUMNS])
    seen = labels[:, shift : shift + COLUMNS]
    if light:
        noise = np.random.default_rng(1).standard_normal(cells.shape)
        cells = unit(cells + light * unit(noise))
    scores: Floats = np.full((*seen.shape, 4), 0.1, np.float32)
    np.put_along_axis(scores, seen[..., None], 0.5, axis=-1)
    return PhotoCells(cells, scores, seen != PERSON, EXTENT)


def kinds_of(found: changes.Changes) -> list[tuple[str, int]]:
    return [(one.kind, one.label) for one in found.changes]


def test_a_chair_that_is_gone_is_told_with_what_is_there_instead() -> None:
    found = changes.find(place((LEFT, CHAIR)), place(), SAME, components)

    [gone] = found.changes
    assert (gone.kind, gone.label, gone.instead, gone.now) == ("gone", CHAIR, FLOOR, None)
    assert gone.then is not None
    assert gone.then.centre == pytest.approx((13 / COLUMNS, 17 / COLUMNS), abs=1.5 / COLUMNS)
    assert 10 * 10 <= gone.then.cells.sum() <= 12 * 12  # cells are averaged 3 x 3: at most one more on each side
    assert gone.then.share == gone.then.cells.mean()
    assert found.compared == 1


def test_later_is_the_other_way_round() -> None:
    one = changes.find(place((LEFT, CHAIR)), place(), SAME, components)
    other = changes.find(place(), place((LEFT, CHAIR)), SAME, components)

    assert kinds_of(one) == [("gone", CHAIR)]
    assert kinds_of(other) == [("new", CHAIR)]
    assert one.changes[0].confidence == pytest.approx(other.changes[0].confidence)


def test_a_chair_on_the_other_side_has_moved() -> None:
    found = changes.find(place((LEFT, CHAIR)), place((RIGHT, CHAIR)), SAME, components)

    [moved] = found.changes
    assert (moved.kind, moved.label, moved.instead) == ("moved", CHAIR, None)
    assert moved.then is not None
    assert moved.now is not None
    assert moved.now.centre[0] - moved.then.centre[0] == pytest.approx(32 / COLUMNS, abs=1.5 / COLUMNS)


def test_another_thing_on_the_other_side_is_not_the_same_thing_moved() -> None:
    found = changes.find(place((LEFT, CHAIR)), place((RIGHT, CABINET)), SAME, components)

    assert sorted(kinds_of(found)) == [("gone", CHAIR), ("new", CABINET)]


def test_a_thing_in_the_place_of_another_is_both() -> None:
    found = changes.find(place((LEFT, CHAIR)), place((LEFT, CABINET)), SAME, components)

    assert sorted((one.kind, one.label, one.instead) for one in found.changes) == [
        ("gone", CHAIR, CABINET),
        ("new", CABINET, CHAIR),
    ]


@pytest.mark.parametrize("light", [0.0, 0.3, 0.8])
def test_other_light_alone_changes_nothing(light: float) -> None:
    things = ((LEFT, CHAIR), (RIGHT, CABINET))
    found = changes.find(place(*things), place(*things, light=light), SAME, components)

    assert found.changes == ()


def test_a_camera_that_moved_aside_is_told_by_the_transform() -> None:
    aside = np.array([[1.0, 0, -6 / COLUMNS], [0, 1, 0]])
    things = ((LEFT, CHAIR), (RIGHT, CABINET))
    found = changes.find(place(*things), place(*things, shift=6), aside, components)

    assert found.changes == ()
    assert found.compared == pytest.approx(54 / 60)


def test_what_lies_beyond_one_photo_is_not_gone() -> None:
    aside = np.array([[1.0, 0, -18 / COLUMNS], [0, 1, 0]])
    found = changes.find(place((LEFT, CHAIR)), place((LEFT, CHAIR), shift=18), aside, components)

    assert found.changes == ()


def test_people_come_and_go_unreported() -> None:
    for then, now in (((LEFT, PERSON), (RIGHT, PERSON)), ((LEFT, CHAIR), (LEFT, PERSON))):
        found = changes.find(place(then), place(now), SAME, components)
        assert found.changes == ()
        assert found.compared < 1


def test_small_things_are_left_out() -> None:
    speck = (slice(12, 14), slice(8, 10))

    assert changes.find(place((speck, CHAIR)), place(), SAME, components).changes == ()


def test_photos_of_nothing_but_moving_things_are_not_compared() -> None:
    whole = (slice(0, ROWS), slice(0, COLUMNS + 20))
    found = changes.find(place((whole, PERSON)), place(), SAME, components)

    assert (found.changes, found.compared) == ((), 0)


def test_all_regions_are_told_with_how_sure_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    then, now = place((LEFT, CHAIR)), place()
    [region] = changes.find_lost(then, now, SAME, components).gone

    assert 0 < region.confidence < 1
    for surer, told in ((1e-6, 0), (0.0, 1)):
        monkeypatch.setattr(changes, "SURE", region.confidence + surer)
        assert len(changes.find(then, now, SAME, components).changes) == told


def test_a_doubtful_end_is_told_with_the_sure_one_of_the_same_thing() -> None:
    lost = changes.find_lost(place((LEFT, CHAIR)), place((RIGHT, CHAIR)), SAME, components)
    # Where a thing came to stand, the floor that it covers is a doubtful region of its own.
    one, other = (max(some, key=lambda region: region.confidence) for some in (lost.gone, lost.new))

    def told(first: Region, second: Region) -> list[tuple[Region, Region]]:
        return changes.moved(replace(lost, gone=[first], new=[second]), SAME)

    def with_contrast(region: Region, contrast: float) -> Region:
        return replace(region, features={**region.features, "contrast": contrast})

    doubtful = with_contrast(other, 0.42)
    assert one.confidence > changes.SURE > doubtful.confidence > changes.HINT
    assert told(one, doubtful) == [(one, doubtful)]
    assert told(with_contrast(one, 0.42), doubtful) == []
    assert told(one, with_contrast(other, 0.2)) == []
