"""What wrong answers get in maps, kept in memory while these stay the same."""

from datetime import datetime

from schemas.comparisons import MapLevels
from schemas.latest import Latest
from schemas.records import MapRecord
from worker.service.ports import Comparisons

MOST_KEPT = 10_000
"""Maps; some 500 bytes each."""


class KnownLevels:
    """Levels of maps by their own recipes, read once for each revision of a map.

    Parameters
    ----------
    comparisons : Comparisons
        Part of the store.
    """

    def __init__(self, comparisons: Comparisons) -> None:
        self._comparisons = comparisons
        self._kept: Latest[str, tuple[tuple[datetime, int, str], MapLevels]] = Latest(MOST_KEPT)

    def of(self, record: MapRecord) -> MapLevels:
        """What wrong answers get in a map; raises NotFound."""
        kept = self._kept.get(record.name)
        if kept is None or kept[0] != (record.created_at, record.revision, record.description.id):
            levels = self._comparisons.levels(record.name, record.description.id)
            kept = (record.created_at, levels.revision, record.description.id), levels
            self._kept[record.name] = kept
        return kept[1]
