"""Finding candidates: the flat index, the catalogue that keeps it level with the store, and the searcher."""
