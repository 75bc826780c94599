"""What training minimises, from a batch to a scalar."""
