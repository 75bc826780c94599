"""Make queries whose place was never enrolled, from a set in which every query has an answer."""

from dataclasses import replace

import numpy as np

from lab.datasets.dataset import Dataset


def hold_out(dataset: Dataset, share: float, generator: np.random.Generator) -> Dataset:
    """Take all right answers of some queries out of the database.

    Parameters
    ----------
    dataset : Dataset
        Without `allowed`: in online loop closure most frames are unanswerable anyway.
    share : float
        Of the answerable queries that lose their answers, 0..1. They follow each other (from a random one on, around
        the end): held out singly, queries of a walk would still find the frame next to their place and be blamed
        for knowing it. Queries that share answers with those lose them too.
    generator : numpy.random.Generator

    Returns
    -------
    Dataset
        The same queries, a smaller database.

    Raises
    ------
    ValueError
        For loop closure, or when nothing would be left to answer with.
    """
    if dataset.allowed is not None:
        raise ValueError(f"{dataset.name}: images cannot be held out of an online loop closure")
    answerable = np.flatnonzero(dataset.judged().answerable)
    chosen = np.roll(answerable, -int(generator.integers(max(len(answerable), 1))))[: round(share * len(answerable))]
    gone = np.zeros(len(dataset.database), np.bool_)
    for query in chosen:
        gone[dataset.positives[query]] = True
    if gone.all():
        raise ValueError(f"{dataset.name}: holding out {share:.0%} of the queries leaves no database")
    number = np.cumsum(~gone) - 1
    positions, names = dataset.database_positions, dataset.places
    return replace(
        dataset,
        name=f"{dataset.name} ({share:.0%} held out)",
        database=tuple(p for p, absent in zip(dataset.database, gone, strict=True) if not absent),
        positives=tuple(number[p[~gone[p]]].astype(np.int64) for p in dataset.positives),
        database_positions=None if positions is None else positions[~gone],
        places=names if names is None else tuple(n for n, absent in zip(names, gone, strict=True) if not absent),
    )
