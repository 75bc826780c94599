"""Images that show mostly things that move."""

from schemas.description import Floats
from schemas.recipe import DescriptionRecipe

MOSTLY_MOVES = 0.2
"""Share of static cells below which an image shows too little of its place."""


def problem_of(label_shares: Floats, static_share: float, recipe: DescriptionRecipe) -> str | None:
    """What is wrong with an image that shows mostly things that move, in words; None for others.

    The static share alone does not tell: a recipe may limit how many cells are left out, whatever they show. So the
    labels of all cells count too.

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
