"""Networks and stand-ins that turn an image into a field of embeddings."""
