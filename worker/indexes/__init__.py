"""Adapters that find the nearest histograms."""
