"""Queries whose answers are golden."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tests.golden.adapter import Query
from tests.golden.images import image
from tests.golden.maps import FEW, MAPS


@dataclass(frozen=True)
class Case:
    """A query to one of MAPS."""

    map: str
    image: str
    top: int = 5
    candidates: int | None = None
    filters: Mapping[str, Any] = field(default_factory=dict)

    def query(self) -> Query:
        """The query as it is sent."""
        return Query(image(self.image), self.top, self.candidates, self.filters)


def _town(image: str, **query: Any) -> Case:
    return Case("town", image, **query)


CASES: Mapping[str, Case] = {
    # what is seen
    "the same picture": _town("lane", top=3),
    "another spot": _town("lane, aside", top=6),
    "dusk": _town("lane, at dusk", top=3),
    "night": _town("lane, at night", top=3),
    "a bus in front": _town("lane, behind a bus", top=3),
    "between two views": _town("lane, 3.5 m on", top=3),
    "grey": _town("lane, grey", top=3),
    "tiny": _town("lane, tiny", top=3),
    "held upright": _town("station, held upright", top=3),
    "held across": _town("chapel, held across", top=3),
    "dull weather in a park": _town("park, dull", top=3),
    "a person in a garden": _town("garden, behind a person", top=3),
    "turned in a corridor": _town("corridor, turned", top=3),
    "never enrolled": _town("stranger", top=3),
    "a blank wall": _town("wall", top=3),
    "fog": _town("fog", top=3),
    # how many
    "one match": _town("lane, at dusk", top=1),
    "one match, never enrolled": _town("stranger", top=1),
    "more matches than views": _town("lane, at dusk", top=100),
    "histograms alone": _town("lane, aside", candidates=0, top=4),
    "one candidate": _town("lane, aside", candidates=1),
    "two candidates and others behind them": _town("lane, at dusk", candidates=2, top=8),
    # filters
    "near": _town("lane, aside", filters={"near": (0, 0, 10)}),
    "at a place": _town("lane, at dusk", filters={"place": "mill lane"}),
    "by metadata": _town("park, dull", filters={"metadata": {"kind": "green"}}),
    "by two metadata": _town("corridor, turned", filters={"metadata": {"kind": "inside", "floor": "2"}}),
    "not the last": _town("lane, 3.5 m on", top=3, filters={"exclude_last": 3}),
    "captured between": _town(
        "corridor, turned", filters={"after": "2026-03-01T09:30:00Z", "before": "2026-03-02T12:00:00Z"}
    ),
    "without some": _town("lane, aside", top=3, filters={"exclude": ["lane", "park"]}),
    "nothing fits": _town("lane, aside", filters={"place": "nowhere"}),
    "not the last of more than there are": _town("lane, aside", filters={"exclude_last": 11}),
    "not those of the last day": _town("lane, aside", filters={"exclude_last": "86400s"}),
    "anywhere on the globe": Case("colours", "blobs 4", top=2, filters={"near_degrees": (-10, 5, 30_000_000)}),
    "near in degrees": Case("colours", "blobs 1, cut", filters={"near_degrees": (48.1001, 11.5, 12)}),
    # maps of every size
    "no view": Case("nobody", "lane, aside"),
    "one view": Case("one view", "lane, aside"),
    "one view of another place": Case("one view", "stranger"),
    "equal views": Case("equal views", "lane, aside"),
    "equal views, one candidate": Case("equal views", "lane, aside", candidates=1, top=4),
    "shapes, asked across": Case("shapes", "lane, aside"),
    "shapes, asked upright": Case("shapes", "station, held upright", top=3),
    "hardly alike in detail": Case("walls", "checks"),
    # parameters
    **{name: Case(name, "lane, at dusk", top=3) for name, map_ in MAPS.items() if map_.views is FEW},
    "two candidates and all others": Case("two candidates", "lane, aside", top=4),
    "paper, the same picture": Case("paper", "lane", top=3),
    "code-words, another spot": Case("code-words", "lane, aside", top=3),
    "ranked by graph, histograms alone": Case("ranked by graph", "lane, at dusk", candidates=0, top=4),
    "ranked by graph, where the second is the surer": Case("ranked by graph", "chapel, held across", top=4),
    "one in full, fog": Case("one in full", "fog", top=4),
    # the encoder of colours
    "colours": Case("colours", "blobs 1, cut"),
    "colours, darker": Case("colours", "blobs 2, darker", top=2),
    "colours, nothing alike": Case("colours", "blobs 7"),
    "colours, a blank wall": Case("few, in colours", "wall"),
    "colours, not alike in detail": Case("few, in colours", "checks"),
    "colours, few candidates": Case("colours", "blobs 2, darker", candidates=2, top=6),
    "colours, others would be ahead": Case(
        "only histograms", "checks", candidates=1, filters={"exclude": ["blobs 2", "blobs 3"]}
    ),
    "colours, paper": Case("colours, paper", "blobs 1, cut"),
    "most of it moves, half of it counts": Case("roads move", "blobs 3", top=3),
    # refusals
    "all of it moves": Case("roads move, paper", "wall"),
    "not a picture": Case("nobody", "no picture"),
    "too small a picture": Case("nobody", "stamp"),
    "no map": Case("no such vocabulary", "wall"),
}
