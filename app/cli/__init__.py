"""The verbs of ``./revisit``: one module per group, each with `add(verbs)` for its arguments and functions that run."""
