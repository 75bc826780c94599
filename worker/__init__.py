"""What is done to pictures: the verbs of revisit."""

import os

# The products of numpy and torch are small here, and their threads wait for one another: on a machine whose cores are
# busy, verifying ten candidates took 250 ms instead of 6. Both libraries read this when they are first imported. What
# `torch.set_num_threads` says is not enough: oneDNN's products obey it in the thread that said it only. A network that
# torch runs gets its threads by that call all the same.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
