"""Fixtures for every test."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared() -> Path:
    """The development data beside the checkout; its tests are skipped, loudly, without it."""
    root = Path(os.environ.get("REVISIT_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    if not root.is_dir():
        pytest.skip(f"SKIPPED FOR WANT OF DATA: no folder {root}; set REVISIT_SHARED to the development data")
    return root
