"""The commands of ``./revisit``: one module per group; its `add(verbs)` declares arguments and the function to run."""
