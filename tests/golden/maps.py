"""The maps that the golden tests query; each is made when first needed and never changed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tests.golden.adapter import TERMS, EncoderName, MapOptions, View
from tests.golden.images import image


@dataclass(frozen=True)
class Enrolled:
    """A view of a map: its image's name, and its attributes."""

    image: str
    said: Mapping[str, Any] = field(default_factory=dict)

    def view(self) -> View:
        """The view to enrol, named as its image."""
        return View(self.image, image(self.image), **self.said)


@dataclass(frozen=True)
class Map:
    """A map: encoder, recipe, and views in the order of enrolment."""

    encoder: EncoderName
    views: Sequence[Enrolled]
    options: MapOptions = field(default_factory=MapOptions)


def only(*terms: str) -> dict[str, float]:
    """Weight 1 for these terms and 0 for the others."""
    return {term: float(term in terms) for term in TERMS}


def _numbers(**numbers: Any) -> MapOptions:
    return MapOptions(numbers=numbers)


def _enrolled(*names: str) -> tuple[Enrolled, ...]:
    return tuple(Enrolled(name) for name in names)


TOWN = (
    Enrolled(
        "lane", {"place": "mill lane", "position": {"x": 0, "y": 0, "heading": 90}, "metadata": {"kind": "street"}}
    ),
    Enrolled("lane, 2 m on", {"place": "mill lane", "position": {"x": 2, "y": 0.5}, "metadata": {"kind": "street"}}),
    Enrolled("station", {"place": "station road", "position": {"x": 80, "y": 10}, "metadata": {"kind": "street"}}),
    Enrolled("park", {"place": "castle park", "position": {"x": 40, "y": 60, "z": 3}, "metadata": {"kind": "green"}}),
    Enrolled("garden", {"captured_at": "2026-03-01T09:30:00Z", "metadata": {"kind": "green", "floor": 0}}),
    Enrolled("corridor", {"captured_at": "2026-03-02T09:30:00Z", "metadata": {"kind": "inside", "floor": 2}}),
    Enrolled("hall", {"captured_at": "2026-03-03T09:30:00Z", "position": {"x": -30, "y": 5}}),
    Enrolled("chapel, upright", {"place": "chapel row", "position": {"x": 5, "y": 90}}),
    Enrolled("lane, 5 m on", {"place": "mill lane", "position": {"x": 5, "y": 1}, "metadata": {"kind": "street"}}),
    Enrolled("green, wide", {"place": "the green", "position": {"x": -60, "y": -60}, "metadata": {"kind": "green"}}),
)
"""Ten places of all kinds and of three shapes."""

FEW = _enrolled("station", "lane", "park", "corridor")
"""Four places of one shape, for maps with other parameters."""

COLOURS = tuple(
    Enrolled(f"blobs {seed}", {"position": {"lat": 48.1 + seed / 10_000, "lon": 11.5, "alt": 500.0 + seed}})
    for seed in range(6)
)
"""Six patches of colour in the order of a walk to the north."""

_CHANGED: Mapping[str, tuple[EncoderName, MapOptions]] = {
    # description
    "without cells": ("compact", _numbers(dense_cells=None)),
    "hard assignment": ("compact", _numbers(assignments={"semantic": 1, "detail": 1})),
    "other channel weights": ("compact", _numbers(channel_weights={"semantic": 0.8, "detail": 0.2})),
    "own labels": ("compact", MapOptions(labels=["sky", "building", "road", "tree", "car"], dynamic=["car", "tree"])),
    "paper": ("compact", MapOptions("paper")),
    "code-words": ("compact", MapOptions("code-words")),
    "without local features": ("compact", _numbers(local_features=None)),
    # ranking
    "nothing in full": ("compact", _numbers(full_resolution_top_k=0)),
    "one in full": ("compact", _numbers(full_resolution_top_k=1)),
    "more in full than there are": ("color", _numbers(full_resolution_top_k=100)),
    "never detail only": ("compact", _numbers(detail_only_top_k=0)),
    "nothing moves": ("color", MapOptions(dynamic=[])),
    "detail only for one": ("color", _numbers(detail_only_top_k=1)),
    "other scales as good": ("compact", _numbers(scale_penalty=0)),
    "one verified": ("color", _numbers(verification_top_k=1)),
    "ranked by graph": ("compact", _numbers(ranking="graph", graph_cosine=0.6)),
    "graph of all pairs": ("color", _numbers(graph_cosine=-1.0, graph_tau=2.0, weights=only("graph"))),
    "two candidates": ("color", _numbers(candidates=2)),
    **{f"only {term}": ("color", _numbers(weights=only(term))) for term in TERMS},
}

BUSY = Map("color", _enrolled(*(f"strip {seed}" for seed in range(7))))
"""A map that changes while it is queried."""

ROAD_AND_SKY = ("road", "sky")

MAPS: Mapping[str, Map] = {
    "town": Map("compact", TOWN),
    "shapes": Map("compact", _enrolled("lane, upright", "lane, square", "lane, wide", "station", "park")),
    "nobody": Map("compact", ()),
    "one view": Map("compact", _enrolled("lane")),
    "equal views": Map("compact", _enrolled("station", "lane, as tiff", "lane, as bmp", "lane, saved again")),
    "walls": Map("compact", _enrolled("white wall", "wall")),
    **{name: Map(encoder, FEW, options) for name, (encoder, options) in _CHANGED.items()},
    "few, in colours": Map("color", FEW),
    "colours": Map("color", COLOURS),
    "only histograms": Map("color", COLOURS, _numbers(weights=only("histogram.semantic", "histogram.detail"))),
    "colours, paper": Map("color", COLOURS, MapOptions("paper")),
    "roads move": Map("color", COLOURS[:3], MapOptions(labels=ROAD_AND_SKY, dynamic=["road"])),
    "roads move, paper": Map("color", (), MapOptions("paper", labels=ROAD_AND_SKY, dynamic=["road"])),
    "no such vocabulary": Map("color", (), _numbers(vocabulary_size={"semantic": 100})),
    "busy, at rest": BUSY,
}

FACTS = ("town", "equal views", "own labels", "paper", "code-words", "colours", "no such vocabulary")
"""Maps whose facts, and those of their views, are golden."""
