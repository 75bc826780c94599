"""What an answer of a map has to reach to be `matched`."""

from dataclasses import dataclass

from schemas.comparisons import MapLevels
from worker.method.calibration import Calibration
from worker.method.features import expected_levels, features, floor


@dataclass(frozen=True)
class MatchStandard:
    """By what a map calls an answer `matched`.

    Parameters
    ----------
    precision : float
        Share of matched answers that must be right, 0..1.
    levels : MapLevels
        What wrong answers get in the map.
    calibration : Calibration
    """

    precision: float
    levels: MapLevels
    calibration: Calibration

    def would_match(self, score: float, next_best: float, breadth: float, others: int) -> bool:
        """Whether a query would be `matched` with a view.

        Parameters
        ----------
        score : float
            Of that view, 0..1.
        next_best : float
            Score of the best view of any other place, 0..1.
        breadth : float
            Of the lead over that one.
        others : int
            Number of other places, or of views of them where the places are not known.
        """
        usual = expected_levels(self.levels)
        read = features(score, next_best, usual, breadth, floor(others, usual))
        return bool(self.calibration.probabilities([read])[0] >= self.calibration.threshold(self.precision))
