"""One word per thing, the field's where it has one (docs/glossary.md): replaced words do not come back."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.http.document import document

ROOT = Path(__file__).parents[1]
ROOMS = ("app", "worker", "schemas", "client", "lab", "scenes", "training", "tests")

BANNED_PARTS = frozenset(
    {
        *("question", "questions", "asked", "picture", "pictures", "likeness", "likenesses", "sureness"),
        *("stranger", "strangers", "nearness", "distinctness", "closely", "desk"),
    }
)
"""Words that no part of a name may be: ``query_image``, not ``question_picture``."""

BANNED_NAMES = frozenset(
    {
        *(
            "House",
            "Served",
            "Condition",
            "Settled",
            "Entrance",
            "Door",
            "Said",
            "Where",
            "Found",
            "Asked",
            "Seen",
            "Look",
        ),
        *("READERS", "FineWords", "fine_words", "hand_in", "beside", "exchange", "stronger", "stretch", "typical"),
    }
)
"""Names that may not be given, compared whole."""

BANNED_FIELDS = frozenset({"word", "close", "typical", "high", "keypoints", "alone", "shares"})
"""Former names of fields on the wire."""

KEPT = frozenset({"views_by_picture", "no-picture", "not-a-picture"})
"""An index of the database, and problem types: data folders and programs rely on them."""


def parts(name: str) -> set[str]:
    """The words of a snake_case or CamelCase name."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)}


def names(path: Path) -> Iterator[str]:
    """All names that a file gives or uses."""
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.arg(arg=name):
                yield name
            case ast.keyword(arg=str(name)):
                yield name


@pytest.mark.parametrize("room", ROOMS)
def test_no_identifier_has_a_word_that_was_replaced(room: str) -> None:
    found = {
        (str(path.relative_to(ROOT)), name)
        for path in (ROOT / room).rglob("*.py")
        for name in names(path)
        if name not in KEPT and (name in BANNED_NAMES or parts(name) & BANNED_PARTS)
    }
    assert sorted(found) == []


@pytest.mark.parametrize("room", ROOMS)
def test_no_file_or_folder_has_one(room: str) -> None:
    paths = [path.relative_to(ROOT) for path in (ROOT / room).rglob("*.py")]
    assert [str(path) for path in paths if any(parts(part) & BANNED_PARTS for part in path.with_suffix("").parts)] == []


def fields(schema: Any) -> Iterator[str]:
    """Names of all properties and parameters in an OpenAPI document."""
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        if "in" in schema and "name" in schema:
            yield schema["name"]
        for value in schema.values():
            yield from fields(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from fields(value)


def test_none_is_on_the_wire() -> None:
    found = {name for name in fields(document()) if name in BANNED_FIELDS or parts(name) & BANNED_PARTS}
    assert found == set()
