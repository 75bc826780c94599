"""Tests of what training minimises."""
