"""What an examination finds, and what mends it."""

from collections.abc import Callable
from dataclasses import dataclass, field

import sqlalchemy as sa

BACKUP = "restore a backup, or enrol again what is missing"
REPAIR = "./revisit doctor --repair"

Mend = Callable[[sa.Connection], str]
"""Mends a finding in a writing transaction, and says what it did."""


@dataclass(frozen=True)
class Finding:
    """Something that is wrong with a data folder.

    Parameters
    ----------
    where : str
        File, map, view or row.
    what : str
        What is wrong there.
    remedy : str
        What to do about it.
    mend : function or None
        Mends it; None for what `worker.storage.repairing` handles otherwise, or nothing can.
    """

    where: str
    what: str
    remedy: str
    mend: Mend | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.where}: {self.what}; {self.remedy}"
