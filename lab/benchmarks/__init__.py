"""Commands that measure revisit; every number in the docs comes from one of them."""

import worker  # noqa: F401  # before anything imports numpy
