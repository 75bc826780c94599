"""One module per change, named by its revision."""
