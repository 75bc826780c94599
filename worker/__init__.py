"""What is done to pictures: the verbs of revisit."""

import os

# The products of numpy are small here, and their threads wait for one another: on a machine whose cores are busy,
# verifying ten candidates took 250 ms instead of 6. OpenBLAS and OpenMP read this when they are first imported. A
# network that torch runs gets its threads by `torch.set_num_threads` all the same.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Nothing is sent anywhere: ONNX Runtime 1.31 keeps an id of the machine in the home folder and reports to its maker
# what it loads, unless it reads this when it is first imported.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"

# A proxy is for other machines: this one's own addresses would be the proxy's there. A shared encoder, a store, a
# receiver of webhooks and a collector of traces may all be here, and every library that calls them goes by this.
_spared = os.environ.get("no_proxy", os.environ.get("NO_PROXY", "")).strip()
if _spared != "*" and any(name.lower() in ("http_proxy", "https_proxy", "all_proxy") for name in os.environ):
    _names = [name.strip() for name in _spared.split(",") if name.strip()]
    os.environ["no_proxy"] = ",".join(dict.fromkeys([*_names, "localhost", "127.0.0.1", "::1"]))
