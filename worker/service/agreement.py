"""N-consistency: images in a row that are matched one by one and come back to one stretch of the map.

A check of loop closures that is usual in SLAM, as in ORB-SLAM (Mur-Artal et al. 2015), where three keyframes in a row
must agree: an image that is taken for another place stands alone, a robot that is back goes on along the way.
"""

from dataclasses import dataclass

REACH = 5
"""Views, by order of enrolment, that successive images may lie apart, in either direction."""


@dataclass(frozen=True)
class Row:
    """Images in a row that agree, up to the last one.

    Parameters
    ----------
    images : int
        How many; 0 where the last one was not matched.
    order : int
        How many views of the map were enrolled before the last one's match.
    """

    images: int = 0
    order: int = 0

    def followed_by(self, order: int | None) -> "Row":
        """The row with one more image: the order of the view that it matches by itself, None where it matches none."""
        if order is None:
            return Row()
        near = self.images > 0 and abs(order - self.order) <= REACH
        return Row(self.images + 1 if near else 1, order)
