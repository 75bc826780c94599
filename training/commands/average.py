"""Average two runs: ``python -m training.commands.average --checkpoints A.pt B.pt --weight 0.4 --to C.pt``.

Where two runs began with the same weights, or the second with those of the first, networks between the two keep much of
what each is good at and often generalise better (Wortsman et al. 2022, "Model soups" and "Robust fine-tuning of
zero-shot models").
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from torch import Tensor


def averaged(first: Mapping[str, Tensor], second: Mapping[str, Tensor], weight: float) -> dict[str, Tensor]:
    """Average two state dicts.

    Parameters
    ----------
    first, second : mapping of str to Tensor
        Tensors that the first lacks are taken from the second as they are.
    weight : float
        Of the first, 0..1; the second has the rest.

    Raises
    ------
    ValueError
        The second lacks a tensor of the first: the runs did not begin with the same weights.
    """
    missing = sorted(first.keys() - second.keys())
    if missing:
        raise ValueError(
            f"the second run lacks {', '.join(missing[:4])}: it did not begin with the first one's weights"
        )
    return {
        name: weight * first[name] + (1 - weight) * tensor if name in first else tensor
        for name, tensor in second.items()
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the second checkpoint with the average of both runs' averaged weights."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.average", description="Average the weights of two runs."
    )
    parser.add_argument("--checkpoints", type=Path, nargs=2, required=True, help="the second may have more layers")
    parser.add_argument("--weight", type=float, required=True, help="of the first checkpoint, 0..1")
    parser.add_argument("--to", type=Path, required=True, help="checkpoint to write")
    options = parser.parse_args(arguments)
    if not 0 <= options.weight <= 1:
        parser.error(f"--weight is between 0 and 1, not {options.weight}")
    first, second = (torch.load(path, map_location="cpu", weights_only=True) for path in options.checkpoints)
    second["average"] = averaged(first["average"], second["average"], options.weight)
    second["averaged_with"] = {"share": options.weight, "steps": first["step"], "minutes": round(first["seconds"] / 60)}
    torch.save(second, options.to)


if __name__ == "__main__":
    main()
