"""What all tests may ask for."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# A busy machine is slow, not wrong.
settings.register_profile("revisit", deadline=None, max_examples=60, print_blob=True)
settings.load_profile("revisit")

ROOT = Path(__file__).parents[1]
os.environ["PYTHONPATH"] = os.pathsep.join((str(ROOT), str(ROOT / "client")))  # for the processes that tests start

SHARED = os.environ.pop("REVISIT_SHARED", None)
"""Taken out of the environment, where settings refuse a ``REVISIT_`` variable that they do not know."""


@pytest.fixture(scope="session")
def shared() -> Path:
    """The development data: `REVISIT_SHARED`, or ``shared`` beside the checkout. Too large for the repository."""
    folder = Path(SHARED or ROOT.parent / "shared")
    if not folder.is_dir():
        pytest.skip(f"NOT RUN: needs the development data, and there is none at {folder}; set REVISIT_SHARED to it")
    return folder
