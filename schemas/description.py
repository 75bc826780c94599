"""Pixel fields and descriptions of images: frozen arrays with checked shapes."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Integers = npt.NDArray[np.integer]
Int8s = npt.NDArray[np.int8]
Booleans = npt.NDArray[np.bool_]
Doubles = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

SEMANTIC = "semantic"
"""Name of the language-aligned layer, which every encoder has, and of its channel."""

DETAIL = "detail"
"""Name of the appearance layer, which some encoders have, and of its channel."""


@dataclass(frozen=True, eq=False)
class PixelField:
    """Embeddings of an image's cells, in one or more layers.

    Parameters
    ----------
    layers : mapping of name to float32 of shape (rows, columns, channels)
        Unit length per cell. ``semantic`` lies in the space of `Encoder.text_vectors`.
        All layers share rows and columns.
    extent : (float, float)
        (width, height) of the image as fractions of its longer side.
    """

    layers: Mapping[str, Floats]
    extent: tuple[float, float]

    def __post_init__(self) -> None:
        if SEMANTIC not in self.layers:
            raise ValueError(f"a pixel field needs the layer {SEMANTIC!r}; it has {sorted(self.layers)}")
        shapes = {layer.shape[:2] for layer in self.layers.values()}
        if len(shapes) != 1 or any(layer.ndim != 3 for layer in self.layers.values()):
            raise ValueError(f"all layers share (rows, columns); seen: {shapes}")

    @property
    def semantic(self) -> Floats:
        """The language-aligned layer, float32 (rows, columns, channels)."""
        return self.layers[SEMANTIC]

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns) of the grid of cells."""
        rows, columns = self.semantic.shape[:2]
        return rows, columns


@dataclass(frozen=True, eq=False)
class ContextGraph:
    """Centroids of labelled regions (paper, "Context Graph"), before matching.

    Nodes are ordered by label, then row, then column of the region's first cell.

    Parameters
    ----------
    labels : int16 of shape (nodes,)
        Index into the map's label set.
    positions : float32 of shape (nodes, 2)
        (x, y) of the centroid, in fractions of the image's longer side.
    embeddings : float32 of shape (nodes, channels)
        Unit length; the embedding of the region's cell nearest to the centroid.
    shares : float32 of shape (nodes,)
        Share of the image's cells in the region.
    """

    labels: npt.NDArray[np.int16]
    positions: Floats
    embeddings: Floats
    shares: Floats

    def __post_init__(self) -> None:
        n = len(self.labels)
        if self.positions.shape != (n, 2) or len(self.embeddings) != n or self.shares.shape != (n,):
            raise ValueError(
                f"{n} labels, {self.positions.shape} positions, {self.embeddings.shape} embeddings, "
                f"{self.shares.shape} shares do not describe the same nodes"
            )

    def __len__(self) -> int:
        return len(self.labels)


@dataclass(frozen=True, eq=False)
class LocalFeatures:
    """Keypoints and their descriptors for geometric verification.

    Parameters
    ----------
    positions : float32 of shape (keypoints, 2)
        (x, y) in fractions of the image's longer side.
    descriptors : int8 of shape (keypoints, channels)
        Reduced descriptors times 127; inner products are proportional to cosines up to rounding.
    """

    positions: Floats
    descriptors: Int8s

    def __post_init__(self) -> None:
        if self.positions.shape != (len(self.descriptors), 2):
            raise ValueError(f"{self.positions.shape} positions for {self.descriptors.shape} descriptors")

    def __len__(self) -> int:
        return len(self.descriptors)


@dataclass(frozen=True, eq=False)
class Appearance:
    """The part of a description that re-ranking reads of all candidates.

    Parameters
    ----------
    coarse : int8 of shape (rows, columns, dimensions)
        Dense cells at half size; 0 rows and columns when the recipe has none.
    graph : ContextGraph
    extent : (float, float)
        (width, height) of the image as fractions of its longer side.
    """

    coarse: Int8s
    graph: ContextGraph
    extent: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Description:
    """The description of one image by one recipe.

    Parameters
    ----------
    vectors : mapping of channel to float32 of shape (dimensions,)
        Histogram vector of each channel of the recipe.
    appearance : Appearance
    cells : int8 of shape (rows, columns, dimensions)
        Dense cells at full resolution: the channels' embeddings joined; 0 rows and columns when the recipe has none.
    keypoints : LocalFeatures or None
        None when the recipe has no local features.
    label_shares : float32 of shape (labels,)
        Share of the image's cells that carry each label; sums to 1.
    static_share : float
        Share of cells that are static, 0..1.
    descriptor_count : int
        Number of pixel descriptors that the histograms count.
    """

    vectors: Mapping[str, Floats]
    appearance: Appearance
    cells: Int8s
    keypoints: LocalFeatures | None
    label_shares: Floats
    static_share: float
    descriptor_count: int
