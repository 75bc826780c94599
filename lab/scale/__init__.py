"""Sets among distractors: how well the right view is found in large maps."""
