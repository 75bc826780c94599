"""Two similarities of dense cells, of all channels joined and of one channel alone, fused by their maximum.

Joined cells recognise a place by night and in snow, because the semantic channel stays the same. In the same light it
blurs what the detail channel tells apart. Which of the two suits a query shows in the candidates: the view of the right
place stands out more from the other candidates by one similarity than by the other.
"""

from collections.abc import Collection

import numpy as np

from schemas.description import Floats, Int8s
from worker.method import dense_cells
from worker.method.byte_vectors import Product, float_product, scale
from worker.method.hough import Doubles

REFERENCE_QUANTILE = 0.85
"""Quantile of the candidates' similarities that a candidate has to stand out from. High enough for rare kinds of
places, and below the other views of the right place, which are few."""

LARGEST_RATE = 2.0
"""Upper bound of `align_scale`, which is 0.9 to 1.5 on photographs. Where hardly any candidate agrees with the query in
one channel, as with a blank wall or thick fog, the factor would grow without bound."""


def slice_channel(cells: Int8s, channels: Collection[str], channel: str) -> Int8s:
    """Cut one channel out of joined cells.

    Parameters
    ----------
    cells : int8 of shape (..., dimensions)
        As `worker.method.dense_cells.join` makes them, of channels with equally many numbers each.
    channels : collection of str
        All channels that were joined.
    channel : str
        The channel to cut out.

    Returns
    -------
    int8 of shape (..., dimensions / number of channels)
    """
    width = cells.shape[-1] // len(channels)
    at = sorted(channels).index(channel) * width
    return cells[..., at : at + width]


def length(cells: Int8s) -> float:
    """Root mean square length of cells, relative to unit length; 1 where all are zero.

    Notes
    -----
    At full resolution the slice of a channel has the length sqrt(its weight). At half resolution, where four cells were
    averaged, the slice of a channel that changes more from cell to cell is shorter.
    """
    squares = np.square(cells.astype(np.float32)).sum(axis=-1)
    return float(np.sqrt(squares.mean())) * scale(cells) or 1.0


def single_channel_similarity(
    query: Int8s,
    candidates: Int8s,
    channels: Collection[str],
    channel: str,
    product: Product = float_product,
    *,
    cell_aspect: Doubles | None = None,
) -> Floats:
    """Similarity of candidates to a query by the cells of one channel alone.

    Parameters
    ----------
    query : int8 of shape (rows, columns, dimensions)
    candidates : int8 of shape (candidates, rows, columns, dimensions)
    channels, channel
        As `slice_channel` takes them.
    product : Product
    cell_aspect : float64 of shape (candidates, 2), optional
        As in `worker.method.dense_cells.compare`.

    Returns
    -------
    float32 of shape (candidates,)
        0..1, as in `worker.method.hough.Agreement`.
    """
    ours, theirs = (slice_channel(cells, channels, channel) for cells in (query, candidates))
    return dense_cells.compare(ours, theirs, product, length(ours), cell_aspect=cell_aspect, measured=False).scores


def align_scale(joined: Floats, alone: Floats, high: float = REFERENCE_QUANTILE) -> float:
    """Factor that makes the similarities of one channel comparable with those of all channels joined.

    Parameters
    ----------
    joined, alone : float32 of shape (candidates,)
        Similarities of the same candidates, at least one.
    high : float
        Quantile that is made equal.

    Returns
    -------
    float
        Quotient of the two `high` quantiles, at most `LARGEST_RATE`; 0 where that of `alone` is 0.
    """
    usual, other = (float(np.quantile(scores, high)) for scores in (joined, alone))
    return min(usual / other, LARGEST_RATE) if other > 0 else 0.0


def max_fusion(joined: Floats, alone: Floats, rate: float) -> Floats:
    """For each candidate the larger of both similarities, that of the single channel scaled by `align_scale`.

    Parameters
    ----------
    joined : float32 of shape (n,)
    alone : float32 of shape (m,)
        Of the first m candidates, m at most n.
    rate : float
        As `align_scale` gives it.

    Returns
    -------
    float32 of shape (n,)
        At most 1 where `joined` is.
    """
    merged = joined.copy()
    merged[: len(alone)] = np.maximum(joined[: len(alone)], np.minimum(alone * np.float32(rate), 1))
    return merged
