"""Training of the built-in encoder: data, losses, models and the commands that use them; judged through `lab`."""
