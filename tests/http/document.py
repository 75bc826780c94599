"""The service's OpenAPI document."""

from functools import cache
from typing import Any

from tests.http.fakes import FakeRuntime


@cache
def document() -> dict[str, Any]:
    """Made once for all tests that read it, since that takes half a second; not to be changed."""
    return FakeRuntime().app().openapi()
