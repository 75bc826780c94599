"""Impostors: descriptions of pictures that show no place of any map, with which every query is compared.

A wall close by, the sky or a page of text is much like any other of its kind, and a park is like other parks. Where a
map has one place of such a kind, a query of the kind stands out from all of its other views. What the query gets of
pictures that are certainly of none of its places says how little that means (cohort normalisation of speaker
verification: Auckenthaler et al. 2000).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from schemas.comparisons import KnownView
from schemas.description import Appearance, ContextGraph, Floats, Int8s
from schemas.records import Candidates
from worker.method import dense_cells
from worker.method.byte_vectors import Product, quantise
from worker.method.shortlist import rough_similarity

LOOKED = 4
"""Pictures that are most like the query by their rough cells, and so compared with it."""

COMPARED = 2
"""How many of those are compared at full resolution."""


@dataclass(frozen=True, eq=False)
class ImpostorEvidence:
    """What a query gets of pictures that show no place of its map.

    Parameters
    ----------
    score : float
        The largest, 0..1, as views are scored but for graphs and keypoints.
    cells : tuple of float32 of shape (rows * columns,)
        As `worker.method.evidence.Ranking.cells`, of those compared at full resolution.
    elsewhere : bool
        Whether the one with that score shows a place, though none of any map.
    """

    score: float
    cells: tuple[Floats, ...]
    elsewhere: bool = False


@dataclass(frozen=True, eq=False)
class Impostors:
    """Descriptions by one recipe, numbered from 0; implements `worker.method.cascade.FetchCells`.

    Parameters
    ----------
    vectors : mapping of channel to float32 of shape (n, dimensions)
        Histogram vectors; none where they are by another vocabulary than the views.
    full : int8 of shape (n, rows, columns, dimensions)
        Dense cells at full resolution.
    extent : (float, float)
        (width, height) of all of the pictures as fractions of the longer side.
    placeless : int
        Number of the first of them that show no place at all; the others show places that are in no map.
    """

    vectors: Mapping[str, Floats]
    full: Int8s
    extent: tuple[float, float]
    placeless: int

    @cached_property
    def coarse(self) -> Int8s:
        """Dense cells at half size, int8 of shape (n, rows // 2, columns // 2, dimensions)."""
        return quantise(dense_cells.halve(self.full))

    def near(
        self, vectors: Mapping[str, Floats], coarse: Int8s, product: Product, usual: Mapping[str, float]
    ) -> Candidates:
        """The `LOOKED` pictures most like a query by their cells.

        Parameters
        ----------
        vectors : mapping of channel to float32 of shape (dimensions,)
            Histogram vectors of the query.
        coarse : int8 of shape (rows, columns, dimensions)
            Its dense cells at half size.
        product : Product
        usual : mapping of channel to float
            Distance from the query that the pictures are taken to have where they have no histograms.
        """
        rough = rough_similarity(coarse, list(self.coarse), product)
        seqs = np.sort(np.argsort(-rough, kind="stable")[:LOOKED]).astype(np.int64)
        distances = {
            name: np.linalg.norm(self.vectors[name][seqs] - theirs, axis=1).astype(np.float32)
            if name in self.vectors
            else np.full(len(seqs), usual[name], np.float32)
            for name, theirs in vectors.items()
        }
        ranks = {name: np.argsort(np.argsort(values, kind="stable")) + 1 for name, values in distances.items()}
        return Candidates(revision=0, searched=len(self.full), seqs=seqs, order=seqs, distances=distances, ranks=ranks)

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        """Half-resolution cells; the graphs are empty."""
        return [Appearance(self.coarse[seq], _EMPTY, self.extent) for seq in seqs]

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        """Full-resolution cells."""
        return [self.full[seq] for seq in seqs]

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        """They have no name, no position, and no map that compared them."""
        return [KnownView() for _ in seqs]


_EMPTY = ContextGraph(
    np.zeros(0, np.int16), np.zeros((0, 2), np.float32), np.zeros((0, 1), np.float32), np.zeros(0, np.float32)
)
