"""The tutorial's protocol, against figures counted by hand."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.datasets import aligned
from lab.datasets.dataset import Dataset
from lab.datasets.tutorial import diagonal
from lab.evaluation.measuring import measure
from lab.evaluation.querying import query_all, ranked_by
from lab.metrics.recall import DEPTHS, chance
from schemas.errors import InvalidParameters
from tests.lab.datasets.drawn import image
from tests.lab.fakes import FakeRetriever


def walks(count: int, near: int) -> Dataset:
    files = tuple(Path(f"{i}.jpg") for i in range(count))
    near_enough = tuple(np.arange(max(0, i - 2), min(count, i + 3), dtype=np.int64) for i in range(count))
    return diagonal(Dataset("walk", files, files, near_enough, "+-2"), near)


def test_right_is_the_frame_of_the_same_number_and_its_neighbours_are_neither() -> None:
    found = walks(6, near=2)
    assert [p.tolist() for p in found.positives] == [[0], [1], [2], [3], [4], [5]]
    assert found.ignored is not None
    assert [n.tolist() for n in found.ignored] == [[1, 2], [0, 2, 3], [0, 1, 3, 4], [1, 2, 4, 5], [2, 3, 5], [3, 4]]
    assert found.truth == "the frame of the same number; 2 before and after it are ignored"


def test_neighbouring_queries_are_one_walk_although_they_share_no_right_answer() -> None:
    assert walks(6, near=1).sequential
    assert not walks(6, near=0).sequential


def test_eight_frames_either_way() -> None:
    found = walks(40, near=8)
    assert found.ignored is not None
    assert found.ignored[20].tolist() == [*range(12, 20), *range(21, 29)]


def test_figures_by_hand() -> None:
    """Six frames, two ignored on either side; what a query is like is written out."""
    dataset = walks(6, near=2)
    distances = np.full((6, 6), 9, np.float32)
    distances[0] = [3, 1, 2, 9, 9, 9]  # 1 and 2 are nearer and ignored: right at rank 1
    distances[1] = [9, 5, 9, 9, 4, 9]  # 4 is wrong, and before 1: rank 2
    distances[2] = [0, 0, 1, 0, 0, 2]  # all that is nearer is ignored: rank 1
    distances[3] = [1, 9, 9, 1, 9, 9]  # 0 is wrong and as near; ties go to the lower number: rank 2
    distances[4] = [1, 2, 9, 9, 3, 9]  # rank 3
    distances[5] = [1, 1, 1, 0, 0, 2]  # 3 and 4 are ignored; 0, 1, 2 are before it: rank 4
    [figures] = measure(dataset, ranked_by(distances, dataset, "by hand"))
    assert figures.first == (1, 2, 1, 2, 3, 4)
    assert [figure.value for figure in figures.recall] == pytest.approx([2 / 6, 1, 1, 1])


def test_chance_counts_what_can_be_answered_alone() -> None:
    # Of 6 frames 4, 3, 2, 2, 3, 4 can be right or wrong.
    expected = (1 / 4 + 1 / 3 + 1 / 2 + 1 / 2 + 1 / 3 + 1 / 4) / 6
    assert chance(walks(6, near=2).judged(), depths=(1,)).tolist() == pytest.approx([expected])


def test_a_service_is_wanted_more_answers_so_that_twenty_remain(tmp_path: Path) -> None:
    files = {name: [image(tmp_path / name / f"{i}.jpg") for i in range(40)] for name in ("database", "query")}
    dataset = diagonal(aligned.read(tmp_path)[0], 8)
    assert dataset.database == tuple(files["database"])

    answers = query_all(dataset, FakeRetriever(lambda a, b: 1 - abs(a - b) / 100 - (a == b)))

    assert answers.ranked.shape == (40, DEPTHS[-1])
    # Query 20 is least like its own frame, and the sixteen around it are left out.
    assert answers.ranked[20][:4].tolist() == [11, 29, 10, 30]
    assert (answers.ranked[20] >= 0).sum() == 20
    assert answers.before is not None
    assert (answers.before[20] >= 0).sum() == 20
    assert answers.confidence is None, "of a first answer that may be one of those left out"
    [after, before] = measure(dataset, answers)
    assert after.known_place is None
    assert before.gain is None


def test_walks_of_other_lengths_are_refused() -> None:
    dataset = walks(6, near=2)
    shorter = replace(dataset, queries=dataset.queries[:5], positives=dataset.positives[:5], ignored=None)
    with pytest.raises(InvalidParameters, match=r"walk .* has 5 and 6"):
        diagonal(shorter)


def test_an_image_is_not_right_and_ignored() -> None:
    dataset = walks(6, near=2)
    with pytest.raises(ValueError, match="right for a query and ignored"):
        replace(dataset, ignored=dataset.positives)
