"""Records the present answers as the golden ones: ``python -m tests.golden.record``."""

import json
import tempfile
from pathlib import Path
from typing import Any

from tests.golden import races
from tests.golden.cases import CASES
from tests.golden.descriptions import DESCRIBED
from tests.golden.gallery import Gallery
from tests.golden.maps import FACTS

Golden = dict[str, dict[str, Any]]
"""Golden values by section (answers, maps, races, descriptions) and name."""

EXPECTED = Path(__file__).with_name("expected.json")


def recorded() -> Golden:
    """All golden values."""
    with tempfile.TemporaryDirectory() as folder, Gallery(Path(folder)) as gallery:
        return {
            "maps": {name: gallery.map(name)[2] for name in FACTS},
            "answers": {name: gallery.answered(name) for name in CASES},
            "races": {"one deleted": races.without(gallery, 1), "four deleted": races.without(gallery, 4)},
            "descriptions": {name: gallery.described(*of) for name, of in DESCRIBED.items()},
        }


def written(values: Golden) -> str:
    """The values as JSON, one line each; floats are written so that reading gives the same bits."""
    sections = []
    for section, named in values.items():
        entries = []
        for name, value in named.items():
            lines = [f"   {json.dumps(key)}: {json.dumps(inner)}" for key, inner in value.items()]
            entries.append(f"  {json.dumps(name)}: {{\n" + ",\n".join(lines) + "\n  }")
        sections.append(f" {json.dumps(section)}: {{\n" + ",\n".join(entries) + "\n }")
    return "{\n" + ",\n".join(sections) + "\n}\n"


def read() -> Golden:
    """The recorded values."""
    values: Golden = json.loads(EXPECTED.read_text())
    return values


if __name__ == "__main__":
    EXPECTED.write_text(written(recorded()))
