"""What is done to pictures: the verbs of revisit."""
