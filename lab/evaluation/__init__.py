"""Parts of an evaluation: querying, measuring, reporting. `lab.evaluate` puts them together."""
