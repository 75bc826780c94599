"""What the parts of the store have in common."""

from worker.storage.database import Database
from worker.storage.image_files import Images


class Part:
    """A part of the store: some of its promises, kept with one database and one folder of images.

    Parameters
    ----------
    database : Database
    images : Images
    """

    def __init__(self, database: Database, images: Images) -> None:
        self._database = database
        self._images = images
