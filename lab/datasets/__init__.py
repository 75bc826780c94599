"""Readers of picture sets with ground truth; each explains what it expected when a folder is not right."""
