"""Base of the parts of the store."""

from worker.storage.damage import Quarantine
from worker.storage.database import Database
from worker.storage.image_store import ImageStore


class Part:
    """A part of the store: one group of its methods, over the shared database and folder of images.

    Parameters
    ----------
    database : Database
    images : ImageStore
    """

    def __init__(self, database: Database, images: ImageStore) -> None:
        self._database = database
        self._images = images
        self._quarantine = Quarantine(database)
