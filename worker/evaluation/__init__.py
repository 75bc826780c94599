"""Parts of an evaluation: asking, measuring, reporting. `worker.evaluate` puts them together."""
