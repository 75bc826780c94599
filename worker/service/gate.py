"""The quality gate: refuses an image for what only its description tells."""

from schemas.description import Description
from schemas.records import Claim
from worker.service import duplicates, moving
from worker.service.duplicates import NearDuplicates


class QualityGate:
    """Judges described images before their descriptions are stored, so that no search ever finds what is refused.

    Parameters
    ----------
    duplicates : NearDuplicates
    """

    def __init__(self, duplicates: NearDuplicates) -> None:
        self._duplicates = duplicates

    def problem_of(self, claim: Claim, description: Description) -> str | None:
        """Why the image of a job is refused, in words; None when it is not, or when nobody asked for that."""
        if not claim.refuse_poor:
            return None
        recipe = claim.recipe
        moves = moving.problem_of(description.label_shares, description.static_share, recipe)
        if moves is not None:
            return moves
        same = self._duplicates.of(claim.view.map, recipe.id, description, but=claim.view.seq)
        return None if same is None else duplicates.detail_of(same)
