"""How revisit is used: HTTP, the command line, the console."""

import worker  # noqa: F401  # sets up the process before numpy is imported
