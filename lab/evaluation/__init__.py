"""Parts of an evaluation: asking, measuring, reporting. `lab.evaluate` puts them together."""
