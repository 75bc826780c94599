"""Where vectors are searched: in memory, or in the database."""

from typing import Literal, Protocol

from worker.search.catalogue import Catalogue as MemoryCatalogue
from worker.search.database_index import DatabaseCatalogue, InsideSearch
from worker.search.flat_index import FlatIndex
from worker.search.ports import Catalogue, DescriptionReader, MapReader, Selecting, VectorReader

Kind = Literal["faiss", "pgvector", "pgvector-hnsw"]


class _Store(Protocol):
    """What the catalogues read."""

    @property
    def maps(self) -> MapReader: ...

    @property
    def descriptions(self) -> DescriptionReader: ...

    @property
    def listings(self) -> Selecting: ...

    @property
    def vectors(self) -> VectorReader | None: ...


def make_catalogue(store: _Store, kind: Kind) -> tuple[Catalogue, Selecting]:
    """The catalogue of a kind of index, and what turns filters into the selections that it searches."""
    if store.vectors is None:
        return MemoryCatalogue(store.maps, store.descriptions, FlatIndex.of), store.listings
    return DatabaseCatalogue(store.vectors, store.descriptions, approximate=kind == "pgvector-hnsw"), InsideSearch()
