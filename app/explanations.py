"""The latest explained queries, so that their explanation can be drawn when somebody wants to see it."""

from collections import OrderedDict
from dataclasses import dataclass

from schemas.description import Description
from schemas.errors import NotFound
from schemas.picture import Picture
from worker.search import Answer, Found


@dataclass(frozen=True, eq=False)
class Explained:
    """What drawing an explanation takes.

    Parameters
    ----------
    picture : Picture
        Made small; explanations are drawn at this size.
    """

    picture: Picture
    description: Description
    answer: Answer

    def match(self, view_id: str | None) -> Found:
        """The match with that view, or the first one; raises NotFound."""
        for found in self.answer.found:
            if view_id is None or found.view.id == view_id:
                return found
        raise NotFound("match", view_id or "1", "the query has no such match")


class Explanations:
    """Keeps the `most` latest explained queries.

    Parameters
    ----------
    most : int
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[str, Explained] = OrderedDict()

    def keep(self, query_id: str, explained: Explained) -> None:
        """Remember one, and forget the oldest beyond the bound."""
        self._kept[query_id] = explained
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)

    def get(self, query_id: str) -> Explained:
        """One of the latest; raises NotFound."""
        try:
            return self._kept[query_id]
        except KeyError:
            raise NotFound(
                "explained query", query_id, f"ask with explain=true; the latest {self._most} are kept until a restart"
            ) from None
