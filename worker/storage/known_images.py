"""What a database knows of the images beside it, and what an examination of them finds by that."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from worker.storage.finding import REPAIR, Finding

AGAIN = "cannot be mended: enrol the image again, or restore the file from a backup"
ORPHAN = "belongs to no view"
FOREIGN = "says that the images are of another database"
THEIRS = "see REVISIT_DATABASE; if that one is gone, remove this: the next start removes images that no view here needs"
NEW = "holds images already, and nothing was ever enrolled into the database"
LOST = "see REVISIT_DATABASE; if the file of the database was lost, restore a backup of it"


@dataclass
class KnownImages:
    """What a database knows of the images beside it.

    Parameters
    ----------
    running : bool
        Whether a service uses them: it may be writing or removing files just now.
    owners : dict or None
        SHA-256 of each image to the view that needs it, as text; None when the database could not be read.
    own : str or None
        Id of the database.
    new : bool
        Whether nothing was ever enrolled into the database, so that images which nobody has taken are not its.
    elsewhere : bool
        Whether another copy of the database works on them.
    needed : function or None
        Which of these digests views need by now; None: those of `owners`.
    """

    running: bool
    owners: dict[str, str] | None = None
    own: str | None = None
    new: bool = False
    elsewhere: bool = False
    needed: Callable[[list[str]], set[str]] | None = None

    def owner_finding(
        self, owner: str | None, owner_name: str, place: str, holds_any: Callable[[], bool]
    ) -> Finding | None:
        """What says that the images at a place are not of this database.

        Parameters
        ----------
        owner : str or None
            Id of the database that has taken them.
        owner_name, place : str
            Names of the file that says so, and of the place.
        holds_any : function
            Whether there are images at all.
        """
        if owner is not None and self.own is not None and owner != self.own:
            return Finding(owner_name, FOREIGN, THEIRS)
        if owner is None and self.new and not self.running and holds_any():
            return Finding(place, NEW, LOST)
        return None


class ImageFindings:
    """Findings of images that are looked at one by one.

    Parameters
    ----------
    known : KnownImages
    keeps_orphans : bool
        Whether images without a view are no finding: they may be of somebody else, or not stored yet.
    """

    def __init__(self, known: KnownImages, *, keeps_orphans: bool) -> None:
        self._needed, self._tells_orphans = known.needed, known.owners is not None and not keeps_orphans
        self._unseen = dict(known.owners or {})
        self._bad: dict[str, Finding] = {}

    def of(self, digest: str, where: str, fault: str | None) -> Iterator[Finding]:
        """The finding of an image that lies there, if it is known already; `fault`: what is wrong with it."""
        view = self._unseen.pop(digest, None)
        if fault is not None:
            self._bad[digest] = Finding(where, f"{fault}; it is the image of {view or 'no view'}", AGAIN)
        elif view is None and self._tells_orphans:
            yield Finding(where, ORPHAN, f"{REPAIR} removes it")

    def rest(self, where: Callable[[str], str]) -> Iterator[Finding]:
        """Findings of bad and missing images, but for those that no view needs any longer; `where` names a digest."""
        for digest, view in self._unseen.items():
            self._bad[digest] = Finding(where(digest), f"is missing; it is the image of {view}", AGAIN)
        wanted = self._bad.keys() if self._needed is None else self._needed(list(self._bad))
        return (finding for digest, finding in self._bad.items() if digest in wanted)
