"""From a checkpoint of a segmentation network to the files that ship.

``python -m training.commands.export_segmentation --checkpoint FILE --to FOLDER`` writes, beside the exported network
whose space the run embedded in, the weights (float16, a state dict) and the graph of a member of the ensemble, and adds
both with their SHA-256 to ``compact.json`` under the name of the member: ``compact-fine.safetensors`` and
``compact-fine.onnx`` of a ``SegmentationNetwork(97)``, or ``compact-second...`` or ``compact-third...`` of an
``IndependentSegmentationNetwork(97)``.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from training.commands.export import history, name_and_digest
from training.models.checkpoints import shared_digest
from training.models.onnx_graphs import write_independent_graph, write_segmentation_graph
from worker.encoders.compact.ensemble import ENSEMBLE


def export_segmentation(checkpoint: Path, folder: Path, name: str = "compact", member: str | None = None) -> None:
    """Write weights and graph of a segmentation network, and add them to the JSON file.

    Parameters
    ----------
    checkpoint : Path
    folder : Path
        With the exported network.
    name : str
        Of the exported network's files.
    member : str or None
        Which of ENSEMBLE it becomes; None: the first of its kind.

    Raises
    ------
    ValueError
        The run began with another network than that in `folder`; or the network is not of the member's kind: the first
        member shares the network's shallow layers, the others have their own.
    """
    saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
    described = folder / f"{name}.json"
    facts = json.loads(described.read_text())
    network = folder / facts["weights"]["file"]
    began, found = saved["plan"]["shared"], shared_digest(load_file(network))
    if began != found:
        raise ValueError(
            f"{checkpoint} began with shallow layers of SHA-256 {began[:16]}..., {network} has {found[:16]}..."
        )
    independent = any(key.startswith("shallow.") for key in saved["average"])
    member = member or ENSEMBLE[independent]
    if independent == (member == ENSEMBLE[0]):
        raise ValueError(
            f"{checkpoint} has shallow layers {'of its own' if independent else 'in common with the network'}: "
            f"it cannot be the member {member}"
        )
    weights = folder / f"{name}-{member}.safetensors"
    save_file({key: tensor.half().contiguous() for key, tensor in saved["average"].items()}, weights)
    weights.chmod(0o644)
    graph = write_independent_graph(weights) if independent else write_segmentation_graph(network, weights)
    facts[member] = {"weights": name_and_digest(weights), "graph": name_and_digest(graph)} | history(saved)
    described.write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.export_segmentation", description="Write a segmentation network that ships."
    )
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--to", type=Path, default=Path("worker/encoders/weights"))
    parser.add_argument("--member", choices=ENSEMBLE, help="which it becomes; default: the first of its kind")
    options = parser.parse_args(arguments)
    export_segmentation(options.checkpoint, options.to, member=options.member)


if __name__ == "__main__":
    main()
