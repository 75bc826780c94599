"""Images that show mostly things that move."""

from schemas.description import Floats
from schemas.recipe import DescriptionRecipe

MOSTLY_MOVES = 0.2
"""Share of static cells below which an image shows too little of its place."""


def problem_of(label_shares: Floats, static_share: float, recipe: DescriptionRecipe) -> str | None:
    """What is wrong with an image that shows mostly things that move, in words; None for others.

    A recipe may leave out no more than some share of the cells, whatever they show: what the image shows is told by its
    labels.

    Parameters
    ----------
    label_shares : float32 of shape (labels,)
        Of its description.
    static_share : float
        Likewise.
    recipe : DescriptionRecipe
        That it was described by.
    """
    labelled = sum(
        float(share) for share, label in zip(label_shares, recipe.labels, strict=True) if label in recipe.dynamic
    )
    moves = max(labelled, 1 - static_share)
    return f"{moves:.0%} of the image shows things that move" if 1 - moves < MOSTLY_MOVES else None
