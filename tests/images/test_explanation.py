"""The sheet of an explanation: what decided is visible, and nothing leaves the sheet."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from worker.images import explanation
from worker.images.drawing import PAPER
from worker.images.explanation import FOR_MATCH, FOR_RIVAL, INLIER, MARGIN, WIDTH, Headline, Part, Photo, Sheet
from worker.images.palette import colour

RED = np.full((300, 400, 3), (200, 60, 60), np.uint8)
NOTHING = np.zeros((6, 8))
LONG = "the long corridor of the west wing on the second floor " * 4
NAMES = ("gate", LONG, "W" * 200, "東京駅" * 60, "हिन्दी" * 30, "a\u202eb\u200b" * 40)


def cells(*at: tuple[int, int]) -> np.ndarray:
    weights = NOTHING.copy()
    for cell in at:
        weights[cell] = 1 / weights.size
    return weights


def sheet(**changes: object) -> Sheet:
    plain = Sheet(
        headline=Headline("matched", 0.93, "as strong as right answers"),
        query=Photo(RED, "query", "", NOTHING),
        match=Photo(RED, "enrolled: gate", "first match", NOTHING),
        rival=Photo(RED, "enrolled: yard", "rival", NOTHING),
        parts=[Part("cells", 0.4, 0.2), Part("keypoints", 0.1, 0.0), Part("score", 0.5, 0.2)],
        notes=["104 of 448 cells agree"],
        verdict="yard lost by 0.3",
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def decoded(shown: Sheet) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(explanation.explanation_png(shown), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert image is not None
    return np.asarray(image)


def photos(drawn: np.ndarray, count: int = 3) -> list[tuple[slice, slice]]:
    """Where the photos lie: all are of one size here."""
    room = (WIDTH - 2 * MARGIN - explanation.GAP * (count - 1)) // count
    height = round(min(room * 0.75, explanation.PHOTO_HEIGHT))
    width = round(height / 0.75)
    top = 76 + 24 + 40
    lefts = [MARGIN + n * (room + explanation.GAP) + (room - width) // 2 for n in range(count)]
    return [(slice(top, top + height), slice(left, left + width)) for left in lefts]


def at_cell(photo: np.ndarray, row: int, column: int) -> np.ndarray:
    """The pixel in the middle of a cell."""
    height, width = photo.shape[:2]
    middle: np.ndarray = photo[round((row + 0.5) * height / 6), round((column + 0.5) * width / 8)].astype(int)
    return middle


def amount(drawn: np.ndarray, tint: tuple[int, int, int]) -> int:
    return int((drawn == tint).all(axis=2).sum())


def test_agreeing_cells_are_tinted_and_the_rest_is_grey() -> None:
    drawn = decoded(
        sheet(
            query=Photo(RED, "query", "", cells((1, 2))),
            match=Photo(RED, "match", "", cells((2, 3))),
            rival=Photo(RED, "rival", "", cells((4, 5))),
        )
    )

    where = photos(drawn)
    for place, (row, column), tint in zip(
        where, ((1, 2), (2, 3), (4, 5)), (FOR_MATCH, FOR_MATCH, FOR_RIVAL), strict=True
    ):
        photo = drawn[place]
        tinted, plain = at_cell(photo, row, column), at_cell(photo, 0, 0)
        assert np.ptp(plain) == 0
        np.testing.assert_allclose(tinted, RED[0, 0] * 0.45 + np.array(tint) * 0.55, atol=2)


def test_a_heavier_cell_is_tinted_more() -> None:
    weights = cells((1, 2))
    weights[3, 4] = weights[1, 2] / 16
    drawn = decoded(sheet(query=Photo(RED, "query", "", weights)))

    photo = drawn[photos(drawn)[0]]
    heavy, light = (np.abs(at_cell(photo, *cell) - np.array(FOR_MATCH)).sum() for cell in ((1, 2), (3, 4)))
    assert heavy < light < np.abs(RED[0, 0].astype(int) - np.array(FOR_MATCH)).sum()


def test_without_cells_the_photos_are_shown_as_they_are() -> None:
    drawn = decoded(sheet(query=Photo(RED, "query", ""), match=Photo(RED, "match", ""), rival=None))

    assert all((drawn[place] == RED[0, 0]).all() for place in photos(drawn, 2))
    assert drawn.shape[1] == WIDTH


def test_inliers_and_regions_join_query_and_match() -> None:
    plain = decoded(sheet())
    joined = decoded(sheet(inliers=[((0.5, 0.4), (0.3, 0.5))], nodes=[("sky", (0.2, 0.1), (0.6, 0.2))]))

    top = slice(photos(plain)[0][0].start, photos(plain)[0][0].stop)
    first, second, third = (place[1] for place in photos(plain))
    for left, right, crossed in ((first, second, True), (second, third, False)):
        gap = (top, slice(left.stop + 5, right.start - 5))
        assert (plain[gap] != joined[gap]).any() == crossed
    assert amount(joined, INLIER) > 20
    assert amount(joined[top], colour("sky")) > 200


def test_of_many_inliers_some_are_drawn() -> None:
    many = [((x / 200, 0.4), (x / 200, 0.4)) for x in range(200)]
    few = many[:: -(-200 // explanation.SHOWN_INLIERS)]

    drawn = decoded(sheet(inliers=many))
    np.testing.assert_array_equal(drawn, decoded(sheet(inliers=few)))


def test_cells_that_speak_for_either_are_outlined_in_its_colour_on_the_query_alone() -> None:
    speaks = np.zeros((6, 8), np.int8)
    speaks[1:3, 1:3], speaks[4, 5] = 1, -1
    plain, outlined = decoded(sheet()), decoded(sheet(speaks=speaks))

    query, match, rival = photos(plain)
    for tint in (FOR_MATCH, FOR_RIVAL):
        assert amount(outlined[query], tint) > amount(plain[query], tint) + 50
    for place in (match, rival):
        np.testing.assert_array_equal(outlined[place], plain[place])


def test_bars_are_as_long_as_the_parts() -> None:
    below = slice(photos(decoded(sheet()))[0][0].stop + 80, None)

    def bars(*parts: Part) -> tuple[int, int]:
        drawn = decoded(sheet(parts=parts))[below, : WIDTH // 2]
        return amount(drawn, FOR_MATCH), amount(drawn, FOR_RIVAL)

    none, half, whole = (bars(Part("score", value, 0.0))[0] for value in (0.0, 0.5, 1.0))
    assert 0.95 < (whole - none) / (2 * (half - none)) < 1.05
    assert bars(Part("score", 0.5, 0.5))[1] > bars(Part("score", 0.5, 0.0))[1] + 1000


@pytest.mark.parametrize("status", ["matched", "ambiguous", "no_match", "lost_in_a_new_way " * 20])
def test_every_verdict_is_told(status: str) -> None:
    drawn = decoded(sheet(headline=Headline(status, 0.5, "reason")))
    assert (drawn[22:58, MARGIN : MARGIN + 100] != PAPER).any()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("shape", [(300, 400), (40, 900), (900, 40), (3, 3)])
def test_nothing_leaves_the_sheet_whatever_the_names_and_photos(name: str, shape: tuple[int, int]) -> None:
    pixels = np.full((*shape, 3), 90, np.uint8)
    longest = max(shape)
    corner = (shape[1] / longest, shape[0] / longest)
    speaks = np.ones((6, 8), np.int8)
    speaks[:, 4:] = -1

    drawn = decoded(
        Sheet(
            headline=Headline("ambiguous", 0.5, f"{name} {LONG}"),
            query=Photo(pixels, name, name, cells((0, 0))),
            match=Photo(pixels, name, name, cells((5, 7))),
            rival=Photo(pixels, name, name, cells((5, 0))),
            parts=[Part(name, 2.0, -1.0), Part("score", 1.0, 1.0)],
            notes=[f"{name} {LONG}"] * 6,
            verdict=f"{name} {LONG}",
            inliers=[((0.0, 0.0), corner)],
            nodes=[(name, (0.0, 0.0), corner), (name, corner, (0.0, 0.0))],
            speaks=speaks,
        )
    )

    assert drawn.shape[1] == WIDTH
    for border in (drawn[:, : MARGIN - 12], drawn[:, 12 - MARGIN :], drawn[:12], drawn[-6:]):
        assert (border == PAPER).all()


def test_the_key_tells_only_what_is_drawn() -> None:
    without = sheet(query=Photo(RED, "query", ""), match=Photo(RED, "match", ""), rival=None)
    assert decoded(without).shape[0] < decoded(replace(without, match=Photo(RED, "match", "", NOTHING))).shape[0]
