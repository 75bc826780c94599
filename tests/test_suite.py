"""The suite can be run by several processes at once."""

import pytest


def test_no_test_is_named_after_bytes_that_another_process_may_not_have(request: pytest.FixtureRequest) -> None:
    """A compressed parameter holds the second at which it was made: pytest-xdist then refuses to run anything."""
    named = [
        item.nodeid
        for item in request.session.items
        for value in getattr(getattr(item, "callspec", None), "params", {}).values()
        if isinstance(value, bytes) and "\\x" in (text := repr(value)[2:-1]) and text in item.nodeid
    ]
    assert named == []
