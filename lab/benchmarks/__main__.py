"""``./revisit benchmark NAME``, or ``python -m lab.benchmarks NAME``: run one benchmark; without a name, the stages."""

import importlib
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lab.benchmarks.stages import OverHttp

BENCHMARKS = {
    "stages": "the stages of enrolling and querying, at several sizes of a map",
    "lseg": "the paper's network: precision, mode, batch",
    "kitti_protocols": "what each protocol on KITTI is worth, without looking at an image",
    "ranking": "what each part of the ranking gives, on places with ground truth",
    "geometry": "other local features, other verification, and a learned rule, on the first ten",
    "keys": "what checking keys costs each request",
    "cost": "memory, disk, cores and money for maps of a size, by the measured figures and your prices",
    "fleet": "what PostgreSQL costs a query against SQLite, and what a second worker gives",
    "vectors": "searches in memory against searches in PostgreSQL: times, recall, building",
    "sharing": "what a shared encoder costs a query, and how much several services describe with one",
    "memory": "the most memory that a service takes, under loads of several kinds",
    "importing": "how fast recordings are imported, against the encoder's own rate",
    "living": "what filters, drives, recipe switches, snapshots and health cost in a large map",
    "placeless": "whether one wall, page or sky is taken for another",
    "lenses": "queries by a camera with another field of view than the map's",
    "refreshing": "what accepting proposals gives, on three walks along one way",
    "changes": "what is found gone, new and moved: drawn places refurnished, and sets of photos",
    "fit_changes": "the confidence of changes fitted anew, on other drawn places",
    "words": "what words find on labelled photographs",
    "scale": "every set among thousands of views of other sites",
}


def main(arguments: Sequence[str] | None = None, over_http: "OverHttp | None" = None) -> int:
    """Hand over to a benchmark; its own arguments follow its name.

    Parameters
    ----------
    arguments : sequence of str, optional
    over_http : function, optional
        For the stages; see `lab.benchmarks.stages.OverHttp`.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given[:1] in (["-h"], ["--help"]):
        print("usage: revisit benchmark [NAME] [OPTIONS]\n\nWithout NAME: stages. NAME --help lists its options.\n")
        print("benchmarks:\n" + "\n".join(f"  {name:18}{text}" for name, text in BENCHMARKS.items()))
        return 0
    name = given.pop(0) if given and not given[0].startswith("-") else "stages"
    if name not in BENCHMARKS:
        print(f"no benchmark {name!r}; there are: {', '.join(BENCHMARKS)}", file=sys.stderr)
        return 2
    benchmark = importlib.import_module(f"lab.benchmarks.{name}")
    return int((benchmark.main(given, over_http) if name == "stages" else benchmark.main(given)) or 0)


if __name__ == "__main__":
    raise SystemExit(main())
