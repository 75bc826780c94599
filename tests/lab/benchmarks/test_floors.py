import pytest

from lab.benchmarks.floors import Answered, measured, table
from lab.evaluation.in_process import runtime_for_measuring
from scenes import building
from schemas.settings import Settings


@pytest.mark.parametrize(("first", "right"), [((2, 3), "spot"), ((2, 4), "floor"), ((1, 3), "no")])
def test_the_same_spot_of_another_floor_is_wrong(first: tuple[int, int], right: str) -> None:
    assert Answered((2, 3), first, "matched").right == right


def test_a_row_counts_right_floors_and_verdicts() -> None:
    answers = [Answered((1, 1), (1, 1), "matched"), Answered((1, 2), (1, 1), "ambiguous")]
    answers.append(Answered((2, 1), (1, 1), "matched"))

    assert table([("hall", answers)]).splitlines()[-1] == "| hall | 3 | 2 | 1 | 1, 0, 0 | 1, 1, 0 |"


def test_a_building_is_enrolled_and_queried_in_process() -> None:
    with runtime_for_measuring(Settings(encoder="color")) as runtime:
        enrolled, unknown = measured(runtime, "default", building(1, floors=2, spots=1, size=(160, 120)), 1)

    assert [a.truth for a in enrolled] == [(1, 1), (2, 1)]
    assert [a.truth for a in unknown] == [(3, 1)]
