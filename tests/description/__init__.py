"""Tests of description."""
