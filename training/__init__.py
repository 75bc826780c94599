"""Training of the built-in encoder: run with `python -m training`."""
