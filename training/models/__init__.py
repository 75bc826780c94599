"""Networks as they are trained: their teacher, their start, and the files they are read from and written to."""
