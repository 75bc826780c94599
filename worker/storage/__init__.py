"""Adapters that keep maps, views and jobs."""
