"""Base of the parts of the store."""

from worker.storage.damage import Quarantine
from worker.storage.database import Database
from worker.storage.image_files import Images


class Part:
    """A part of the store: one group of its methods, over the shared database and folder of images.

    Parameters
    ----------
    database : Database
    images : Images
    """

    def __init__(self, database: Database, images: Images) -> None:
        self._database = database
        self._images = images
        self._quarantine = Quarantine(database)
