"""Merging: the candidates of several maps become those of one."""

from collections.abc import Sequence

import numpy as np

from schemas.records import Candidates

DECIMALS = 6
"""Distances are ranked after rounding to this many decimals, so that equal vectors keep their enrolment order."""


def merged(several: Sequence[Candidates], count: int) -> Candidates:
    """The candidates that one index of all the views would give.

    Parameters
    ----------
    several : sequence of Candidates
        Of different maps under one recipe, each searched for `count` views of each channel; at least one.
    count : int

    Returns
    -------
    Candidates
        `order` counts the views of one map after those of the maps before it, and `revision` is that of the last.
    """
    if len(several) == 1:
        return several[0]
    starts = np.cumsum([0, *(one.searched for one in several)])
    seqs = np.concatenate([one.seqs for one in several])
    sorting = np.argsort(seqs, kind="stable")
    order = np.concatenate([one.order + start for one, start in zip(several, starts, strict=False)])[sorting]
    distances, ranks = {}, {}
    for channel in several[0].distances:
        distances[channel] = np.concatenate([one.distances[channel] for one in several])[sorting]
        found = np.flatnonzero(np.concatenate([one.ranks[channel] for one in several])[sorting])
        nearest = found[np.lexsort((found, np.round(distances[channel][found], DECIMALS)))][:count]
        ranks[channel] = np.zeros(len(seqs), np.int64)
        ranks[channel][nearest] = np.arange(1, len(nearest) + 1)
    kept = np.any([of > 0 for of in ranks.values()], axis=0)
    return Candidates(
        revision=several[-1].revision,
        searched=int(starts[-1]),
        seqs=seqs[sorting][kept],
        order=order[kept],
        distances={channel: of[kept] for channel, of in distances.items()},
        ranks={channel: of[kept] for channel, of in ranks.items()},
    )
