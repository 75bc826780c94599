"""Sets of images with ground truth, a module for each layout; it says what it expected when a folder is not right."""
