"""How revisit is spoken to: HTTP, the command line, the client."""

import worker  # noqa: F401  # before anything imports numpy
