"""Base of the parts of the store."""

from inspect import isfunction
from typing import Any

from worker.storage.again import run_again
from worker.storage.damage import Quarantine
from worker.storage.database import Database
from worker.storage.image_store import ImageStore


class Part:
    """A part of the store: one group of its methods, over the shared database and folder of images.

    A public method that PostgreSQL rolled back before anything of it was committed is run again (see again.py), so
    besides what it stores it must do the same each time. A class whose methods do not says ``again=False``.

    Parameters
    ----------
    database : Database
    images : ImageStore
    """

    def __init_subclass__(cls, *, again: bool = True, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        for name, method in list(vars(cls).items()):
            if again and isfunction(method) and not name.startswith("_"):
                setattr(cls, name, run_again(method))

    def __init__(self, database: Database, images: ImageStore) -> None:
        self._database = database
        self._images = images
        self._quarantine = Quarantine(database)
