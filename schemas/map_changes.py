"""Changes of a map that take effect together."""

from collections.abc import Callable
from dataclasses import dataclass

from schemas.recipe import MapRecipe, RankingConfig


@dataclass(frozen=True)
class MapChanges:
    """What one `PATCH /maps/{map}` changes; None leaves a field as it is.

    Parameters
    ----------
    ranking : function or None
        From the map's recipe to its new ranking config; when it raises, nothing is changed.
    blur : tuple of str or None
        What is covered in images before they are stored; empty for nothing.
    keep_images : bool or None
    keep_queries, keep_matches : int or None
        How many queries are kept that matched nothing, or a view that they look unlike; 0 for none.
    refuse_poor : bool or None
        Whether poor images are refused.
    """

    ranking: Callable[[MapRecipe], RankingConfig] | None = None
    blur: tuple[str, ...] | None = None
    keep_images: bool | None = None
    keep_queries: int | None = None
    keep_matches: int | None = None
    refuse_poor: bool | None = None

    @property
    def frees(self) -> bool:
        """Whether all that it does is to delete."""
        others = (self.ranking, self.blur, self.refuse_poor)
        return all(other is None for other in others) and not (
            self.keep_images or self.keep_queries or self.keep_matches
        )
