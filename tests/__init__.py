import os
import sys

NUMPY_SPLITS_SUMS = "numpy" in sys.modules and os.environ.get("OPENBLAS_NUM_THREADS") != "1"
"""Whether a plugin of pytest has loaded numpy, with one thread per core, before `worker` could ask for one thread."""

import worker  # noqa: E402, F401  # before anything else imports numpy
