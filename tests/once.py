"""What several processes of a test run would each make is made by one: a folder of this run keeps it for the others."""

import hashlib
import os
import pickle
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

Made = TypeVar("Made")

FOLDER = "MADE_BY_THESE_TESTS"
"""The environment variable that names the folder, also to the processes that pytest-xdist and stories start."""


def make_folder() -> None:
    """Make the folder of this run."""
    os.environ[FOLDER] = tempfile.mkdtemp(prefix="revisit-made-")


def remove_folder() -> None:
    """Remove it, with all that was made."""
    shutil.rmtree(os.environ.pop(FOLDER))


def once(make: Callable[[], Made], kind: str, *of: bytes) -> Made:
    """What `make` makes, or has made in this run for the same bytes.

    Parameters
    ----------
    make : callable
    kind : str
        Name of what it makes.
    of : bytes
        All that it depends on.
    """
    key = hashlib.blake2b(digest_size=20)
    for part in of:
        key.update(len(part).to_bytes(8))
        key.update(part)
    file = Path(os.environ[FOLDER]) / f"{kind}-{key.hexdigest()}"
    try:
        kept: Made = pickle.loads(file.read_bytes())  # by this run
    except FileNotFoundError:
        kept = make()
        with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as begun:
            pickle.dump(kept, begun, pickle.HIGHEST_PROTOCOL)
        Path(begun.name).replace(file)  # whole, for whoever looks meanwhile
    return kept
