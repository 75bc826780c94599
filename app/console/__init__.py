"""HTML pages: API documentation and the console."""
