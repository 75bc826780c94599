"""What is done to pictures: the verbs of revisit."""

import os

# numpy's products are small here, and its threads wait for one another: on a machine whose cores are busy, verifying
# ten candidates took 250 ms instead of 6. OpenBLAS reads this when numpy is first imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
