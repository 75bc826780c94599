"""Studies of the product: data sets, baselines, metrics, evaluation, calibration, ablation and benchmarks."""

import worker  # noqa: F401  # before anything imports numpy
