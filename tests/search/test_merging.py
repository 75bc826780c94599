"""Candidates of several maps are those of one map with all the views."""

from collections.abc import Mapping

import numpy as np
from hypothesis import given, strategies as st

from schemas.description import Floats
from schemas.records import Candidates, Changes, Selection
from worker.search.flat_index import FlatIndex
from worker.search.merging import merged

SIZES = {"semantic": 3, "detail": 2}
EVERYTHING = Selection(None, np.zeros(0, np.int64))


def index(vectors: Floats, seqs: list[int]) -> FlatIndex:
    made = FlatIndex(SIZES, "recipe")
    made.apply(Changes(7, "recipe", np.array(seqs, np.int64), vectors, np.zeros(0, np.int64)))
    return made


def facts(found: Candidates) -> list[tuple[int, Mapping[str, float], Mapping[str, int]]]:
    """Sequence number, distances and ranks of each candidate."""
    return [
        (
            int(seq),
            {name: round(float(of[i]), 5) for name, of in found.distances.items()},
            {name: int(of[i]) for name, of in found.ranks.items()},
        )
        for i, seq in enumerate(found.seqs)
    ]


@given(
    views=st.lists(st.tuples(st.integers(0, 2), st.lists(st.integers(0, 4), min_size=5, max_size=5)), max_size=30),
    query=st.lists(st.integers(0, 4), min_size=5, max_size=5),
    count=st.integers(1, 8),
)
def test_several_maps_are_searched_as_one(views: list[tuple[int, list[int]]], query: list[int], count: int) -> None:
    """Whole numbers, so that many distances are equal."""
    vectors = np.array([vector for _, vector in views], np.float32).reshape(-1, 5)
    wanted = {"semantic": np.array(query[:3], np.float32), "detail": np.array(query[3:], np.float32)}
    owners = [owner for owner, _ in views]
    several = []
    for owner in range(3):
        mine = [seq for seq, of in enumerate(owners) if of == owner]
        several.append(index(vectors[mine], mine).search(wanted, count, EVERYTHING))

    joint = merged(several, count)

    assert facts(joint) == facts(index(vectors, list(range(len(views)))).search(wanted, count, EVERYTHING))
    assert joint.searched == len(views)
    assert len(set(joint.order.tolist())) == len(joint.order)


def test_one_map_stays_as_it_is() -> None:
    alone = index(np.eye(5, dtype=np.float32), list(range(5))).search(
        {"semantic": np.zeros(3, np.float32), "detail": np.zeros(2, np.float32)}, 3, EVERYTHING
    )
    assert merged([alone], 3) is alone
