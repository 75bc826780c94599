"""The same dense cells read in more than one way: all channels joined, or one of them alone.

Joined cells find a place again by night and in snow, because the words in them stay the same. Where the light is the
same the words only blur what the appearance alone would tell apart. Which of both a query needs shows in the
candidates: a view of the right place stands out in one reading more than in the other.
"""

from collections.abc import Collection

import numpy as np

from schemas.description import Floats, Int8s
from worker.method import dense_cells
from worker.method.byte_vectors import Product, float_product, scale
from worker.method.hough import Doubles

REFERENCE_QUANTILE = 0.85
"""Share of the candidates that look less alike than what a candidate has to stand out from: enough for rare kinds of
places, and below the other views of the right place, which are few."""

LARGEST_RATE = 2.0
"""Of an `align_scale`, which is 0.9 to 1.5 on photographs. Where hardly any candidate agrees with the query in one
channel, as with a blank wall or thick fog, what little does would stand out without bound."""


def slice_channel(cells: Int8s, channels: Collection[str], channel: str) -> Int8s:
    """Cut one channel out of joined cells.

    Parameters
    ----------
    cells : int8 of shape (..., dimensions)
        As `worker.method.dense_cells.join` makes them, of channels with equally many numbers each.
    channels : collection of str
        All that were joined.
    channel : str
        One of them.

    Returns
    -------
    int8 of shape (..., dimensions / number of channels)
    """
    width = cells.shape[-1] // len(channels)
    at = sorted(channels).index(channel) * width
    return cells[..., at : at + width]


def length(cells: Int8s) -> float:
    """Root of the mean square length of cells, in units of whole ones; 1 where all are nothing.

    Notes
    -----
    In full a channel's part is as long as the root of its share. At half size, where four cells were averaged, the
    part of a channel that changes more from cell to cell is shorter.
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
    """How well the cells of one channel agree by themselves.

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
    """What a similarity in one reading is multiplied by to be held against one in another.

    Parameters
    ----------
    joined, alone : float32 of shape (candidates,)
        Likenesses of the same candidates, at least one, in either reading.
    high : float
        Share of the candidates that a right one is expected to stand out from.

    Returns
    -------
    float
        So much that what `high` of the candidates do not exceed is the same in both, at most `LARGEST_RATE`; 0 where
        nothing is alike alone.
    """
    usual, other = (float(np.quantile(scores, high)) for scores in (joined, alone))
    return min(usual / other, LARGEST_RATE) if other > 0 else 0.0


def max_fusion(joined: Floats, alone: Floats, rate: float) -> Floats:
    """For each candidate the similarity in whichever reading has it stand out more.

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
