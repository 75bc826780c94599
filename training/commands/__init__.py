"""Command lines, each run as ``python -m training.commands.NAME``; `train` also as ``python -m training``."""
