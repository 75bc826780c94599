"""What training minimises: from a network's output and a batch to a scalar."""
