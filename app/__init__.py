"""How revisit is spoken to: HTTP, the command line, the client."""
