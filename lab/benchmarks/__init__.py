"""Commands that measure revisit; every number in the docs comes from one of them."""
