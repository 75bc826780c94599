"""Base of the parts of the store."""

from inspect import isfunction
from typing import Any

from worker.storage.damage import Quarantine
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.retrying import retried as with_retries


class Part:
    """A part of the store: one group of its methods, over the shared database and folder of images.

    Public methods are retried where PostgreSQL rolled them back before anything was committed (see retrying.py), so
    they must have no effect but on what they store. A class for whose methods that is not so says ``retried=False``.

    Parameters
    ----------
    database : Database
    images : ImageStore
    """

    def __init_subclass__(cls, *, retried: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name, method in list(vars(cls).items()):
            if retried and isfunction(method) and not name.startswith("_"):
                setattr(cls, name, with_retries(method))

    def __init__(self, database: Database, images: ImageStore) -> None:
        self._database = database
        self._images = images
        self._quarantine = Quarantine(database)
