"""Tests of the networks that are trained."""
