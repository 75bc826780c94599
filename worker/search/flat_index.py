"""Exact search with FAISS `IndexFlatL2`, one index per channel of a map."""

import threading
from collections.abc import Mapping

import faiss
import numpy as np

from schemas.description import Floats
from schemas.draw import draw_order
from schemas.recipe import DescriptionRecipe
from schemas.records import Candidates, Changes, Selection, Sequence64
from worker.search.merging import DECIMALS
from worker.search.ports import SAMPLE

SPARE = 8
"""Extra neighbours searched beyond `count`, so that ties at the limit are broken by enrolment order."""


class FlatIndex:
    """The vectors of one map under one recipe, searched exhaustively.

    Rows are in ascending order of `seq`. A lock lets one search or update run at a time.

    Parameters
    ----------
    dimensions : mapping of channel to int
        Lengths of the channels' vectors, in the order in which `Changes.vectors` concatenates them.
    recipe : str
        Id of the description recipe.
    """

    def __init__(self, dimensions: Mapping[str, int], recipe: str) -> None:
        # A search is memory-bound; threads that compete for cores make it several times slower.
        faiss.omp_set_num_threads(1)
        self.recipe = recipe
        self.revision = 0
        self._dimensions = dict(dimensions)
        self._lock = threading.Lock()
        self._seqs: Sequence64 = np.zeros(0, np.int64)
        self._sample: tuple[int, ...] | None = ()  # None: to be drawn again
        self._channels = {name: faiss.IndexFlatL2(size) for name, size in self._dimensions.items()}

    @classmethod
    def of(cls, recipe: DescriptionRecipe) -> "FlatIndex":
        """An empty index of the channels of a recipe."""
        return cls({name: channel.length for name, channel in recipe.parameters.channels.items()}, recipe.id)

    def __len__(self) -> int:
        return len(self._seqs)

    def apply(self, changes: Changes) -> None:
        """Remove deleted views and add or replace described ones; see `Index.apply`."""
        with self._lock:
            replaced = np.isin(self._seqs, np.concatenate([changes.gone, changes.seqs]))
            if replaced.any():
                rows = np.flatnonzero(replaced).astype(np.int64)
                for index in self._channels.values():
                    index.remove_ids(rows)
                self._seqs = self._seqs[~replaced]
            if len(changes.seqs):
                self._add(changes.seqs, changes.vectors)
            self.revision = changes.revision
            if replaced.any() or len(changes.seqs):
                self._sample = None

    def _add(self, seqs: Sequence64, vectors: Floats) -> None:
        late = len(self._seqs) > 0 and seqs[0] < self._seqs[-1]
        start = 0
        for name, size in self._dimensions.items():
            index = self._channels[name]
            index.add(np.ascontiguousarray(vectors[:, start : start + size]))
            start += size
        self._seqs = np.concatenate([self._seqs, seqs])
        if late:  # not described in enrolment order, or again: sort the rows
            order = np.argsort(self._seqs, kind="stable")
            self._seqs = self._seqs[order]
            for name, size in self._dimensions.items():
                stored = faiss.rev_swig_ptr(self._channels[name].get_xb(), len(order) * size).reshape(-1, size)
                sorted_rows = stored[order]
                self._channels[name] = faiss.IndexFlatL2(size)
                self._channels[name].add(sorted_rows)

    def search(self, vectors: Mapping[str, Floats], count: int, selection: Selection) -> Candidates:
        """The union of the nearest views by each channel; see `Index.search`."""
        with self._lock:
            allowed = self._allowed(selection)
            available = len(self._seqs) if allowed is None else len(allowed)
            selector = None if allowed is None else self._selector(allowed)
            found = {name: self._nearest(name, vectors[name], min(count, available), available, selector)
                     for name in vectors}  # fmt: skip
            union = np.unique(np.concatenate(list(found.values())))
            distances = {name: self._distances(name, vectors[name], union) for name in found}
            seqs = self._seqs[union]
            revision = self.revision
        ranks = {}
        for name, rows in found.items():
            ranks[name] = np.zeros(len(union), np.int64)
            ranks[name][np.searchsorted(union, rows)] = np.arange(1, len(rows) + 1)
        return Candidates(
            revision=revision, searched=available, seqs=seqs, order=union, distances=distances, ranks=ranks
        )

    def sample(self) -> tuple[int, ...]:
        """Some views drawn from all; see `SearchableIndex.sample`."""
        with self._lock:
            if self._sample is None:
                order = draw_order(self._seqs)
                first = np.argpartition(order, SAMPLE)[:SAMPLE] if len(order) > SAMPLE else slice(None)
                self._sample = tuple(sorted(int(seq) for seq in self._seqs[first]))
            return self._sample

    def _nearest(
        self, channel: str, vector: Floats, wanted: int, available: int, selector: "faiss.IDSelector | None"
    ) -> Sequence64:
        """Rows of the nearest vectors, nearest first, ties by enrolment order."""
        if wanted == 0:
            return np.zeros(0, np.int64)
        parameters = None if selector is None else faiss.SearchParameters(sel=selector)
        # At most `available`: FAISS pads with -1 beyond.
        squared, rows = self._channels[channel].search(vector[None], min(wanted + SPARE, available), params=parameters)
        distances = np.round(np.sqrt(np.maximum(squared[0], 0)), DECIMALS)
        nearest: Sequence64 = rows[0][np.lexsort((rows[0], distances))[:wanted]]
        return nearest

    def _distances(self, channel: str, vector: Floats, rows: Sequence64) -> Floats:
        size = self._dimensions[channel]
        index = self._channels[channel]
        stored = faiss.rev_swig_ptr(index.get_xb(), index.ntotal * size).reshape(-1, size)
        lengths: Floats = np.linalg.norm(stored[rows] - vector[None], axis=1).astype(np.float32)
        return lengths

    def _allowed(self, selection: Selection) -> Sequence64 | None:
        """Rows of the selection, ascending; None for all rows."""
        if selection.only is None and len(selection.never) == 0:
            return None
        keep = np.ones(len(self._seqs), np.bool_)
        if selection.only is not None:
            keep = np.isin(self._seqs, selection.only)
        if len(selection.never):
            keep &= ~np.isin(self._seqs, selection.never)
        return np.flatnonzero(keep)

    def _selector(self, rows: Sequence64) -> "faiss.IDSelector":
        bits = np.zeros(len(self._seqs), np.bool_)
        bits[rows] = True
        return faiss.IDSelectorBitmap(np.packbits(bits, bitorder="little"))
