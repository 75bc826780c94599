"""Fusion of two similarities of dense cells: of all channels joined, and of one channel alone.

Joined cells find a place again by night and in snow, because the semantic channel stays the same. Under the same light
the detail channel alone separates places better. Which of the two suits a query shows in its candidates: a view of the
right place stands out more in one of them.
"""

from collections.abc import Collection

import numpy as np

from schemas.description import Doubles, Floats, Int8s
from worker.method import dense_cells
from worker.method.byte_vectors import Product, float_product, scale
from worker.method.hough import Agreement

REFERENCE_QUANTILE = 0.85
"""Quantile over the candidates at which two similarities are aligned: high enough to hold for rare kinds of places, and
below the few other views of the right place."""

LARGEST_ALIGN_SCALE = 2.0
"""Upper limit of `align_scale`, which is 0.9 to 1.5 on photographs. Where hardly any candidate agrees with the query in
one channel (a blank wall, thick fog), the factor would otherwise amplify noise without bound."""


def slice_channel(cells: Int8s, channels: Collection[str], channel: str) -> Int8s:
    """Cut one channel out of joined cells.

    Parameters
    ----------
    cells : int8 of shape (..., dimensions)
        From `worker.method.dense_cells.join`; every channel has the same number of dimensions.
    channels : collection of str
        All joined channels.
    channel : str
        The channel to cut out, one of `channels`.

    Returns
    -------
    int8 of shape (..., dimensions / number of channels)
    """
    width = cells.shape[-1] // len(channels)
    at = sorted(channels).index(channel) * width
    return cells[..., at : at + width]


def length(cells: Int8s) -> float:
    """Root mean square length of cells, where joined cells have length 1; 1 where all are zero.

    Notes
    -----
    At full resolution the slice of a channel is as long as the root of its weight. At half resolution, where four
    cells were averaged, the slice of a channel that varies more from cell to cell is shorter.
    """
    squares = np.square(cells.astype(np.float32)).sum(axis=-1)
    return float(np.sqrt(squares.mean())) * scale(cells) or 1.0


def single_channel_agreement(
    query: Int8s,
    candidates: Int8s,
    channels: Collection[str],
    channel: str,
    product: Product = float_product,
    *,
    cell_aspect: Doubles | None = None,
    burstiness: Floats | None = None,
) -> Agreement:
    """How well candidates agree with a query by the cells of one channel.

    Parameters
    ----------
    query : int8 of shape (rows, columns, dimensions)
    candidates : int8 of shape (candidates, rows, columns, dimensions)
    channels, channel
        As in `slice_channel`.
    product : Product
    cell_aspect, burstiness
        As in `worker.method.dense_cells.compare`, the latter as `single_channel_burstiness` gives it.

    Returns
    -------
    Agreement
        Without scales.
    """
    ours, theirs = (slice_channel(cells, channels, channel) for cells in (query, candidates))
    return dense_cells.compare(
        ours, theirs, product, length(ours), cell_aspect=cell_aspect, estimate_scales=False, burstiness=burstiness
    )


def single_channel_burstiness(
    query: Int8s, channels: Collection[str], channel: str, product: Product = float_product
) -> Floats:
    """`worker.method.dense_cells.burstiness_weight` of a query by the cells of one channel."""
    ours = slice_channel(query, channels, channel)
    return dense_cells.burstiness_weight(ours, product=product, length=length(ours))


def align_scale(joined: Floats, alone: Floats) -> float:
    """Factor that makes similarities of one channel alone comparable with those of all channels.

    Parameters
    ----------
    joined, alone : float32 of shape (candidates,)
        Similarities of the same candidates, at least one, by all channels and by one channel.

    Returns
    -------
    float
        Quotient of the two quantiles, joined over alone, at most `LARGEST_ALIGN_SCALE`; 0 where that of `alone` is 0.
    """
    usual, other = (float(np.quantile(scores, REFERENCE_QUANTILE)) for scores in (joined, alone))
    return min(usual / other, LARGEST_ALIGN_SCALE) if other > 0 else 0.0


def max_fusion(joined: Floats, alone: Floats, factor: float) -> Floats:
    """For each candidate the larger of its joined and its scaled single-channel similarity.

    Parameters
    ----------
    joined : float32 of shape (n,)
    alone : float32 of shape (m,)
        Single-channel similarities of the first m candidates, m at most n.
    factor : float
        From `align_scale`.

    Returns
    -------
    float32 of shape (n,)
        At most 1 where `joined` is at most 1.
    """
    merged = joined.copy()
    merged[: len(alone)] = np.maximum(joined[: len(alone)], np.minimum(alone * np.float32(factor), 1))
    return merged


def max_fusion_cells(joined: Agreement, alone: Agreement, factor: float) -> Floats:
    """Weights of the query's cells by that comparison which `max_fusion` takes, float32 (n, cells)."""
    taken, first = joined.cells.copy(), len(alone.scores)
    larger = alone.scores * np.float32(factor) > joined.scores[:first]
    taken[:first][larger] = alone.cells[larger] * np.float32(factor**2)
    return taken
