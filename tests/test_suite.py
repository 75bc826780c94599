"""The suite can be run by several processes at once."""

import pytest


def test_no_test_is_named_after_bytes_that_another_process_may_not_have(request: pytest.FixtureRequest) -> None:
    """A compressed parameter holds the second at which it was made: pytest-xdist then refuses to run anything."""
    assert [item.nodeid for item in request.session.items if r"\x" in item.nodeid] == []
