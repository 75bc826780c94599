"""Descriptions kept in a file, so that thousands of images are described once."""

import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from lab.scale.sources import Decode, Source
from schemas.description import Appearance, Floats, Int8s, LocalFeatures
from schemas.errors import BadImage, NothingStatic
from schemas.recipe import DescriptionRecipe
from worker.description.describer import Describer
from worker.description.ports import Encoder
from worker.storage import packing

COMMIT = 20
"""Descriptions written at once: at most these are lost when the process is stopped."""

_TABLES = """
create table if not exists recipe (id text primary key);
create table if not exists views (
    key text primary key, site text not null, width real, height real, vectors blob, appearance blob, cells blob,
    keypoints blob);
"""


class Cache:
    """Descriptions by one recipe in an SQLite file.

    Parameters
    ----------
    path : Path
        Made when it does not exist.
    recipe : DescriptionRecipe

    Raises
    ------
    ValueError
        The file holds descriptions by another recipe.
    """

    def __init__(self, path: Path, recipe: DescriptionRecipe) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._recipe = recipe
        self._file = sqlite3.connect(path, timeout=60)
        self._file.execute("pragma journal_mode=wal")
        self._file.execute("pragma synchronous=normal")
        self._file.executescript(_TABLES)
        kept = [row[0] for row in self._file.execute("select id from recipe")]
        if not kept:  # otherwise nothing is written, so that measuring does not wait for a run that describes
            self._file.execute("insert into recipe values (?)", (recipe.id,))
            self._file.commit()
            kept = [recipe.id]
        if kept != [recipe.id]:
            raise ValueError(
                f"{path} holds descriptions by the recipe {kept[0]}, not by {recipe.id}; name another file"
            )

    def missing(self, sources: Iterable[Source]) -> Iterator[Source]:
        """Those that are not in the file."""
        known = {row[0] for row in self._file.execute("select key from views")}
        return (source for source in sources if source.key not in known)

    def describe(
        self, sources: Iterable[Source], encoder: Encoder, describer: Describer, decode: Decode
    ) -> Iterator[int]:
        """Describe sources that are missing, and give the number described so far after each."""
        for number, source in enumerate(self.missing(sources), 1):
            self._file.execute(
                "insert into views (key, site, width, height, vectors, appearance, cells, keypoints)"
                " values (?, ?, ?, ?, ?, ?, ?, ?)",
                (source.key, source.site, *self._row(source, encoder, describer, decode)),
            )
            if number % COMMIT == 0:
                self._file.commit()
            yield number
        self._file.commit()

    def vectors(self) -> list[tuple[str, str, Floats]]:
        """Key, site and concatenated histogram vectors of all views that have a description, as they were described."""
        rows = self._file.execute("select key, site, vectors from views where vectors is not null order by rowid")
        return [(key, site, packing.unpack_floats(body)) for key, site, body in rows]

    def appearances(self, keys: Sequence[str]) -> list[Appearance]:
        """Cells at half size, graphs and extents, in the order of `keys`."""
        found = self._read("width, height, appearance", keys)
        return [packing.unpack_appearance(body, (width, height)) for width, height, body in found]

    def cells(self, keys: Sequence[str]) -> list[Int8s]:
        """Cells at full resolution, in the order of `keys`."""
        return [packing.unpack_cells(body) for (body,) in self._read("cells", keys)]

    def local_features(self, keys: Sequence[str]) -> list[LocalFeatures]:
        """Local features, in the order of `keys`."""
        return [packing.unpack_keypoints(body) for (body,) in self._read("keypoints", keys)]

    def _read(self, columns: str, keys: Sequence[str]) -> list[tuple[Any, ...]]:
        marks = ", ".join("?" * len(keys))
        reading = f"select key, {columns} from views where key in ({marks})"  # names of columns, from this class alone
        found = {row[0]: row[1:] for row in self._file.execute(reading, list(keys))}
        return [found[key] for key in keys]

    def _row(self, source: Source, encoder: Encoder, describer: Describer, decode: Decode) -> tuple[object, ...]:
        """What is kept of an image; nothing but its key and site when it cannot be described."""
        try:
            image = source.read(decode)
            field = next(iter(encoder.encode([image])))
            described = describer.describe(image, field, describer.keypoints(image))
        except (BadImage, NothingStatic):
            return (None,) * 6
        found = described.keypoints
        return (
            *described.appearance.extent,
            packing.pack_vectors(described, self._recipe),
            packing.pack_appearance(described.appearance),
            packing.pack_cells(described.cells),
            None if found is None else packing.pack_keypoints(found),
        )
