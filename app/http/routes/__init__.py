"""Routes, one module per group: parse the request, call one use-case, answer."""
