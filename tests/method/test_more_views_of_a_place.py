"""More views of the right place lower neither its score nor its probability, whatever a query is measured by."""

from collections.abc import Sequence

import numpy as np
import pytest

from schemas.comparisons import KnownView, MapLevels
from schemas.description import DETAIL, SEMANTIC, Description, LocalFeatures
from schemas.recipe import RankingConfig, TermWeights
from tests.method.views_in_a_dictionary import QUERY, RECIPE, Dictionary, changed, described, found
from worker.method.byte_vectors import quantise
from worker.method.calibration import Calibration, Logistic
from worker.method.cascade import rank
from worker.method.decision import decide
from worker.method.evidence import Ranking

CONFIG = changed(
    weights=TermWeights(
        dense_full=1.7, dense=0.2, histogram={SEMANTIC: 0.04, DETAIL: 0.04}, graph=0.05, verification=0.4
    ),
    candidates=200,
    full_resolution_top_k=12,
    detail_only_top_k=6,
    verified_top_k=10,
)
LEVELS = MapLevels(compared=20, level=0.3, gap=0.05, others=20, breadth=2.0)
CALIBRATION = Calibration(
    ("gap", "level", "breadth", "either"),
    Logistic(np.array([0.6, -0.2, 0.6, 1.0]), np.array([0.6, 0.3, 0.55, 0.75]), np.array([0.1, 3.4, 1.0, 1.7]), -1.7),
    np.array([0.5, 0.97]),
    np.array([0.4, 0.93]),
    np.array([0.9, 0.6]),
)
"""Much as the one that ships."""
FURTHER = range(11)


def seen(seed: int, semantic: float, detail: float, agreeing: int) -> Description:
    """A view that is as noisy, and of whose forty keypoints so many agree with the query's."""
    view, random = described(seed, semantic, detail), np.random.default_rng(seed)
    assert QUERY.keypoints is not None
    positions, descriptors = QUERY.keypoints.positions.copy(), QUERY.keypoints.descriptors.copy()
    positions[agreeing:] = random.random((40 - agreeing, 2))
    descriptors[agreeing:] = quantise(np.float32(0.25) * random.standard_normal((40 - agreeing, 16)).astype(np.float32))
    return Description(
        view.vectors,
        view.appearance,
        view.cells,
        LocalFeatures(positions, descriptors),
        view.label_shares,
        view.static_share,
        view.descriptor_count,
    )


def ranked(
    home: Sequence[Description], others: Sequence[Sequence[Description]], config: RankingConfig = CONFIG
) -> Ranking:
    """What a map gives with views of the query's place, enrolled last, and with some of each of other places."""
    groups = {f"other {number}": of for number, of in enumerate(others)} | {"home": home}
    views = [(name, view) for name, of in groups.items() for view in of]
    stored = Dictionary(dict(enumerate((view for _, view in views), start=10)))
    stored.attributes = {seq: KnownView(name) for seq, (name, _) in enumerate(views, start=10)}
    return rank(
        QUERY, found({SEMANTIC: [0.6] * len(views), DETAIL: [0.6] * len(views)}, 200), RECIPE, config, stored, top=5
    )


def best(ranking: Ranking, others: Sequence[Sequence[Description]]) -> float:
    """The best score of a view of the query's place."""
    of_home = ranking.seqs >= 10 + sum(map(len, others))
    return float(ranking.scores[of_home].max())


def probability(ranking: Ranking) -> float:
    return decide(ranking, LEVELS, CALIBRATION, 0.97, searched=len(ranking.seqs)).confidence


def others_of(count: int, views: int = 1) -> list[list[Description]]:
    """Views of other places: the more like the query the earlier they come."""
    return [
        [
            seen(1000 + 20 * number + view, 1.1 + 0.1 * number, 1.3 + 0.1 * number, max(9 - number, 2))
            for view in range(views)
        ]
        for number in range(count)
    ]


@pytest.mark.parametrize("views", [1, 4], ids=["others of one view", "others of four"])
@pytest.mark.parametrize("count", [2, 5, 12, 30])
@pytest.mark.parametrize(
    "further",
    [(0.9, 0.9, 30), (1.0, 1.0, 12), (1.3, 0.7, 30), (0.6, 1.5, 20)],
    ids=["as good", "of fewer keypoints", "by detail", "by meaning"],
)
def test_neither_its_score_nor_its_probability_falls(count: int, views: int, further: tuple[float, float, int]) -> None:
    others = others_of(count, views)
    home = [seen(1, 0.9, 0.9, 30), *(seen(2 + i, *further) for i in FURTHER[1:])]

    rankings = [ranked(home[: 1 + more], others) for more in FURTHER]

    scores, probabilities = [best(one, others) for one in rankings], [probability(one) for one in rankings]
    assert min(np.diff(scores)) > -1e-6, scores
    assert min(np.diff(probabilities)) > -1e-6, probabilities
    assert 0.05 < probabilities[0] < 0.95
