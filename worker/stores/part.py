"""What the parts of the store have in common."""

from worker.stores.database import Database
from worker.stores.pictures import Pictures


class Part:
    """A part of the store: some of its promises, kept with one database and one folder of pictures.

    Parameters
    ----------
    database : Database
    pictures : Pictures
    """

    def __init__(self, database: Database, pictures: Pictures) -> None:
        self._database = database
        self._pictures = pictures
