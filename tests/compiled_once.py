"""Statements that a process gives to several databases are compiled once: tests open thousands of new ones."""

from typing import Any

import sqlalchemy
from sqlalchemy.util import LRUCache

STATEMENTS = 4000
"""Statements that are kept at most, for all databases together."""

MADE = sqlalchemy.create_engine


class Compiled(LRUCache[Any, Any]):
    """Statements that were compiled, by dialect and its server's version; an engine's own has them by its dialect."""

    def get(self, key: Any, default: Any = None) -> Any:
        return super().get(_for_all(key), default)

    def __setitem__(self, key: Any, value: Any) -> None:
        super().__setitem__(_for_all(key), value)


def _for_all(key: Any) -> Any:
    dialect, *statement = key
    return (type(dialect), dialect.server_version_info, *statement)


def compile_once() -> None:
    """Have all databases that this process opens from now on share what is compiled."""
    shared = Compiled(STATEMENTS)

    def make(*arguments: Any, **named: Any) -> sqlalchemy.Engine:
        engine = MADE(*arguments, **named)
        engine.update_execution_options(compiled_cache=shared)
        return engine

    sqlalchemy.create_engine = make
