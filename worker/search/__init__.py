"""Finding candidates: flat indexes, the catalogue that keeps them up to date, and reading descriptions."""
