"""Readers of image sets with ground truth; each explains what it expected when a folder is not right."""
