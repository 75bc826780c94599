"""Average of two runs: ``python -m training.commands.average --first A.pt --second B.pt --share 0.4 --to C.pt``.

Where the second run began with the first one's weights, everything between the two is a network too, and keeps much of
what each is good at: the average of a network before and after it was taught something more forgets less of the old and
generalises better than either (Wortsman et al. 2022, "Robust fine-tuning of zero-shot models"). So it does for two runs
that began with the same weights (Wortsman et al. 2022, "Model soups").
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor


def blended(first: Mapping[str, Tensor], second: Mapping[str, Tensor], share: float) -> dict[str, Tensor]:
    """Average two state dicts.

    Parameters
    ----------
    first, second
        What the first lacks is taken from the second as it is.
    share
        Of the first, 0..1.

    Raises
    ------
    ValueError
        The first holds something that the second does not: they are not of one family.
    """
    stray = sorted(first.keys() - second.keys())
    if stray:
        raise ValueError(f"the second run lacks {', '.join(stray[:4])}: it did not begin with the first one's weights")
    return {
        name: share * first[name] + (1 - share) * tensor if name in first else tensor for name, tensor in second.items()
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the second checkpoint with both runs' averaged weights averaged."""
    parser = argparse.ArgumentParser(prog="python -m training.commands.average", description="Average of two runs.")
    parser.add_argument("--first", type=Path, required=True, help="checkpoint that the second began with, or its twin")
    parser.add_argument("--second", type=Path, required=True)
    parser.add_argument("--share", type=float, required=True, help="of the first, 0..1")
    parser.add_argument("--to", type=Path, required=True)
    options = parser.parse_args(arguments)
    if not 0 <= options.share <= 1:
        parser.error(f"--share is between 0 and 1, not {options.share}")
    first, second = (
        torch.load(path, map_location="cpu", weights_only=True) for path in (options.first, options.second)
    )
    second["average"] = blended(first["average"], second["average"], options.share)
    second["blended"] = {"share": options.share, "steps": first["step"], "minutes": round(first["seconds"] / 60)}
    torch.save(second, options.to)


if __name__ == "__main__":
    main()
