"""What travels and what is kept: the nouns of revisit, without I/O."""
