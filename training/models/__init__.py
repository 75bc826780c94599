"""Networks as they are trained: where they start, their teacher, and how they are read and written."""
