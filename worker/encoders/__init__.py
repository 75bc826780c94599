"""Networks and stand-ins that turn a picture into a field of embeddings."""
