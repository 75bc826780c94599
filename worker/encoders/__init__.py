"""Encoders: an image in, a field of embeddings out."""
