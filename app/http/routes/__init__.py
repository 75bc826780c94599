"""One module per group of routes: parse, call one use-case, answer."""
