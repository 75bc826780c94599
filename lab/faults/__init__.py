"""Studies of faults: what breaks the service when disks, processes, clocks and images misbehave."""
