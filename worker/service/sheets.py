"""What the explanation of an answer shows, from the evidence of the ranking."""

from collections.abc import Mapping

import numpy as np

from schemas.description import Int8s
from schemas.image import extent_of
from schemas.records import ViewRecord
from worker.description.describer import components
from worker.images.drawing import Pixels, is_drawn
from worker.images.explanation import Part, Photo, Sheet
from worker.method import cell_evidence, hough
from worker.method.cell_evidence import CellEvidence, Contrast
from worker.service.explanations import Explained, point
from worker.service.results import ScoredView

PARTS = {
    "dense_full": "cells",
    "dense": "cells at half size",
    "histogram.semantic": "semantic histogram",
    "histogram.detail": "detail histogram",
    "graph": "context graph",
    "verification": "keypoints",
}
"""Terms of the score in words; others keep their names."""

COMPARED = {
    "dense_full": "cells agree {}",
    "dense": "cells at half size agree {}",
    "histogram.semantic": "semantic histograms agree {}",
    "histogram.detail": "detail histograms agree {}",
    "graph": "context graphs agree {}",
}
"""Terms of the score in a comparison of two views; the blank is for less or more."""

TOLD = 0.005
"""Differences of a part below this are not told."""

LONGEST = 48
"""Characters of a name within a sentence; titles have room of their own."""

SHEET, GREY = 640, 214
"""Longer side in pixels and level of what is shown where an image is not kept."""

FRAMED = "query, as the map's camera would see it"
"""Title of a query that another camera took."""

ANEW = "the cells of {} are not shown: it was described anew or deleted since"


def cells_of(explained: Explained, scored: ScoredView, stored: Int8s | None) -> CellEvidence | None:
    """The cells of the query that agree with those of a view, as the ranking compared them.

    Parameters
    ----------
    explained : Explained
    scored : ScoredView
    stored : int8 of shape (rows, columns, dimensions), or None
        The view's cells, by the recipe of the query.

    Returns
    -------
    CellEvidence or None
        None when the ranking did not compare cells, or they are not at hand.
    """
    query = explained.description
    if scored.dense is None or stored is None or stored.shape != query.cells.shape or not stored.size:
        return None
    extent = extent_of(scored.view.image.width, scored.view.image.height)
    for one in explained.fixed:
        stored = one.cleared(stored)
    return cell_evidence.agreeing(
        query.cells,
        stored,
        explained.recipe.description.parameters.cell_channels(),
        cell_aspect=hough.cell_aspects(query.appearance.extent, [extent])[0],
        align_scale=scored.dense.align_scale,
    )


def sheet(
    explained: Explained,
    scored: ScoredView,
    image: Pixels | None,
    other: tuple[ScoredView, Pixels | None] | None,
    stored: Mapping[int, Int8s],
) -> Sheet:
    """What the explanation of one match shows.

    Parameters
    ----------
    explained : Explained
    scored : ScoredView
        The match.
    image : uint8 of shape (height, width, 3), or None
        Its photo; None when its map keeps none.
    other : (ScoredView, photo), optional
        The view that it is compared with, and its photo or None.
    stored : mapping of sequence number to int8 of shape (rows, columns, dimensions)
        Cells of the views, by the recipe of the query; those described anew since are absent.
    """
    first = explained.is_first(scored)
    ours = cells_of(explained, scored, stored.get(scored.seq))
    match = _enrolled(scored, image, ours, "first match" if first else f"rank {explained.rank(scored)}")
    notes, rival, contrasted = _notes(explained, scored, ours), None, None
    compared = explained.description.cells.size > 0 and scored.dense is not None
    if compared and ours is None:
        notes.append(ANEW.format(_short(name_of(scored.view))))
    if other is not None:
        against, photo = other
        theirs = cells_of(explained, against, stored.get(against.seq))
        rival = _enrolled(against, photo, theirs, "rival" if first else "first match")
        if compared and against.dense is not None and theirs is None:
            notes.append(ANEW.format(_short(name_of(against.view))))
        if ours is not None and theirs is not None:
            contrasted = cell_evidence.contrast(ours, theirs, explained.description.appearance.extent, components)
    looked = "tinted: agrees with the match" if ours is not None else ""
    title = "query" if explained.photo is None else FRAMED
    query = Photo(explained.image.pixels, title, looked, None if ours is None else ours.of_query())
    return Sheet(
        headline=explained.headline,
        query=query,
        match=match,
        rival=rival,
        parts=_parts(scored, None if other is None else other[0]),
        notes=notes,
        verdict="" if other is None else _verdict(scored, other[0]),
        inliers=_inliers(scored),
        nodes=_nodes(explained, scored),
        speaks=None if contrasted is None else _speaks(contrasted),
    )


def _pixels(view: ViewRecord, photo: Pixels | None) -> Pixels:
    """The photo of a view, or a grey sheet of its form."""
    if photo is not None:
        return photo
    scale = SHEET / max(view.image.width, view.image.height)
    height, width = (max(1, round(side * scale)) for side in (view.image.height, view.image.width))
    return np.full((height, width, 3), GREY, np.uint8)


def name_of(view: ViewRecord) -> str:
    """How a view is called on a drawing: its place, its file name, the file that its metadata names, or its id."""
    attributes = view.attributes
    named = attributes.place or attributes.filename or attributes.metadata.get("file")
    return named if isinstance(named, str) and named else view.id


def _short(name: str) -> str:
    """A name with its middle left out where it is longer than `LONGEST`."""
    half = LONGEST // 2
    return name if len(name) <= LONGEST else f"{name[:half]}…{name[-half:]}"


def _enrolled(scored: ScoredView, photo: Pixels | None, cells: CellEvidence | None, role: str) -> Photo:
    """The photo of a view, with its name, what agrees, and the cells that do."""
    told = [role, f"score {scored.score:.3f}"]
    if cells is not None:
        told.append(f"{len(cells.weight)} cells agree")
    if scored.verified is not None:
        told.append(f"{scored.verified.inliers} keypoints fit")
    if photo is None:
        told.append("image not kept")
    agreeing = None if cells is None else cells.of_candidate()
    return Photo(_pixels(scored.view, photo), f"enrolled: {name_of(scored.view)}", " · ".join(told), agreeing)


def _parts(scored: ScoredView, other: ScoredView | None) -> list[Part]:
    parts = [
        Part(PARTS.get(name, name), value, None if other is None else other.parts.get(name, 0.0))
        for name, value in scored.parts.items()
    ]
    return [*parts, Part("score", scored.score, None if other is None else other.score)]


def _notes(explained: Explained, scored: ScoredView, cells: CellEvidence | None) -> list[str]:
    """The evidence for the match, one sentence each."""
    notes = []
    if cells is not None:
        how = "by their detail alone" if cells.channel else "by all channels"
        count = cells.shape[0] * cells.shape[1]
        notes.append(f"{len(cells.weight)} of {count} cells agree on one displacement, {how}: {_share(scored)}")
    if scored.verified is not None:
        verified = scored.verified
        gated = verified.inliers and not scored.parts.get("verification")
        weak = "; too few more than in other candidates to count" if gated else ""
        notes.append(f"{verified.inliers} of {verified.matches} matched keypoints fit one geometry{weak}")
    if scored.graph is not None:
        pairs, drawn = len(scored.graph.pairs), len(_nodes(explained, scored))
        left = "" if drawn == pairs else f"; {drawn} drawn: the others are small or of things that move"
        sizes = f"{len(explained.description.appearance.graph)} in the query and {len(scored.graph.view)} in the match"
        notes.append(f"{pairs} regions of the context graphs correspond, of {sizes}{left}")
    if scored.dense is not None and scored.dense.scale is not None and abs(scored.dense.scale - 1) >= 0.05:
        notes.append(f"the match shows the place {scored.dense.scale:.2f} times as large as the query")
    return notes


def _share(scored: ScoredView) -> str:
    """How much of the score comes from dense cells."""
    cells = sum(value for name, value in scored.parts.items() if name.startswith("dense"))
    return f"{100 * cells / max(scored.score, 1e-9):.0f} % of the score"


def _verdict(scored: ScoredView, other: ScoredView) -> str:
    """In which parts the other view lost or won."""
    behind = scored.score >= other.score
    gaps = {name: value - other.parts.get(name, 0.0) for name, value in scored.parts.items()}
    signed = sorted(gaps.items(), key=lambda gap: -gap[1] if behind else gap[1])
    told = [_difference(name, scored, other) for name, gap in signed[:3] if (gap if behind else -gap) >= TOLD]
    against, gap = signed[-1]
    although = f", although {_difference(against, scored, other)}" if (-gap if behind else gap) >= TOLD else ""
    result = f"lost by {scored.score - other.score:.3f}" if behind else f"won by {other.score - scored.score:.3f}"
    return f"{_short(name_of(other.view))} {result}: {'; '.join(told) or 'no part differs much'}{although}"


def _difference(name: str, scored: ScoredView, other: ScoredView) -> str:
    """How the other view differs in one part of the score: of keypoints their number, otherwise the part."""
    theirs, ours = other.parts.get(name, 0.0), scored.parts[name]
    if name == "verification":
        counts = [0 if one.verified is None else one.verified.inliers for one in (other, scored)]
        return f"{'fewer' if theirs < ours else 'more'} keypoints fit, {counts[0]} against {counts[1]}"
    phrase = COMPARED.get(name, name + " {}").format("less" if theirs < ours else "more")
    return f"{phrase}, {theirs:.3f} against {ours:.3f}"


def _inliers(scored: ScoredView) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    return [] if scored.verified is None else [(point(pair[:2]), point(pair[2:])) for pair in scored.verified.pairs]


def _nodes(explained: Explained, scored: ScoredView) -> list[tuple[str, tuple[float, float], tuple[float, float]]]:
    """Corresponding regions that are large enough in both images, without those of dynamic labels."""
    if scored.graph is None:
        return []
    recipe, graph, view = (
        explained.recipe.description,
        explained.description.appearance.graph,
        scored.graph.view,
    )
    return [
        (recipe.labels[graph.labels[p]], point(graph.positions[p]), point(view.positions[r]))
        for p, r in scored.graph.pairs
        if is_drawn(graph, p, recipe.labels, recipe.dynamic) and is_drawn(view, r, recipe.labels, recipe.dynamic)
    ]


def _speaks(contrast: Contrast) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
    """1 for cells of regions that speak for the first, -1 for those that speak for the rival, 0 elsewhere."""
    signs = np.array([0, *(np.sign(region.strength) for region in contrast.regions)], np.int8)
    return signs[contrast.numbers]
