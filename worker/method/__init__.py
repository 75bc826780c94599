"""The pure core: each step of the method as a function of arrays; no I/O, clock, environment or global random state."""
