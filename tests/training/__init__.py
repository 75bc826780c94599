"""Tests of the built-in encoder's network and of its training."""
