"""Golden tests: queries are answered as they were when their answers were recorded, stage by stage.

Before and after a change that is to change nothing, on one machine: ``OPENBLAS_NUM_THREADS=1 pytest tests/golden
--golden-exact`` compares to the last bit. Without the option floats may differ by 1e-5, and by a hundredth on a machine
that rounds descriptions otherwise. What is meant to change is recorded anew by ``python -m tests.golden.record``; names
of the product stand in `adapter` alone.
"""
