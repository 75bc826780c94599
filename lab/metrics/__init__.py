"""Figures of merit: recall at N, precision and recall of a claim, and what chance would give."""
