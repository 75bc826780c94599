"""``python -m lab.benchmarks NAME``, or ``./revisit benchmark NAME``: run one benchmark; without a name, the stages."""

import importlib
import sys
from collections.abc import Sequence

BENCHMARKS = {
    "stages": "the stages of enrolling and asking, at several sizes of a map",
    "lseg": "the paper's network: precision, mode, batch",
    "kitti_protocols": "what each protocol on KITTI is worth, without looking at a picture",
    "ranking": "what each part of the ranking gives, on places with ground truth",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Hand over to a benchmark; its own arguments follow its name."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] in (["-h"], ["--help"]):
        print("benchmarks:\n" + "\n".join(f"  {name:18}{text}" for name, text in BENCHMARKS.items()))
        return 0
    name = given.pop(0) if given and not given[0].startswith("-") else "stages"
    if name not in BENCHMARKS:
        print(f"no benchmark {name!r}; there are: {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    return int(importlib.import_module(f"lab.benchmarks.{name}").main(given) or 0)


if __name__ == "__main__":
    raise SystemExit(main())
