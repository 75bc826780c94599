"""JSON merge patch, RFC 7396."""

from collections.abc import Mapping
from typing import Any


def merge(target: object, patch: object) -> Any:
    """The target with the patch merged in: objects merge by name, null removes, anything else replaces."""
    if not isinstance(patch, Mapping):
        return patch
    merged = dict(target) if isinstance(target, Mapping) else {}
    for name, value in patch.items():
        if value is None:
            merged.pop(name, None)
        else:
            merged[name] = merge(merged.get(name), value)
    return merged
