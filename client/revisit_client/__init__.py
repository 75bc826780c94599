"""A typed client of revisit."""
