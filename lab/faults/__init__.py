"""Studies of what a service does when the ground gives way: damaged files."""
