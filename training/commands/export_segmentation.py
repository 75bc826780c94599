"""From a checkpoint of segmentation network to what ships: ``python -m training.commands.export_segmentation --checkpoint FILE --to FOLDER``.

Beside the exported weights that the run began with it writes ``compact-fine.safetensors`` (float16: the state dict of
``FineWords(97)``) and ``compact-fine.onnx``, and names both, with their SHA-256, under ``fine`` in ``compact.json``;
or, from a run with ``--second``, ``compact-second.safetensors`` (of ``SecondFineWords(97)``), ``compact-second.onnx``
and ``second``, or the same for ``third``.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from training.commands.export import history, named, shared_digest
from training.models.onnx_graphs import write_second_graph, write_segmentation_graph
from worker.encoders.compact.encoder import ENSEMBLE


def export_segmentation(checkpoint: Path, folder: Path, name: str = "compact", member: str | None = None) -> None:
    """Write the segmentation network and their graph, and add them to the JSON file.

    Parameters
    ----------
    checkpoint, folder, name
    reader
        Which of READERS they become; None means the first that they can be.

    Raises
    ------
    ValueError
        The run began with other weights than those in `folder`, whose shallow layers or space of words are not the ones
        it learned on; or the first reader was to be one that shares no layers with the network, or the other way round.
    """
    saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
    described = folder / f"{name}.json"
    facts = json.loads(described.read_text())
    weights = folder / facts["weights"]["file"]
    began, found = saved["plan"]["shared"], shared_digest(load_file(weights))
    if began != found:
        raise ValueError(
            f"{checkpoint} began with shallow layers of SHA-256 {began[:16]}..., {weights} has {found[:16]}..."
        )
    apart = any(key.startswith("shallow.") for key in saved["average"])
    member = member or ENSEMBLE[apart]
    if apart == (member == ENSEMBLE[0]):
        raise ValueError(
            f"{checkpoint} has shallow layers {'of its own' if apart else 'in common with the network'}: "
            f"it cannot be the reader {member}"
        )
    fine = folder / f"{name}-{member}.safetensors"
    save_file({key: tensor.half().contiguous() for key, tensor in saved["average"].items()}, fine)
    fine.chmod(0o644)
    graph = write_second_graph(fine) if apart else write_segmentation_graph(weights, fine)
    facts[member] = {"weights": named(fine), "graph": named(graph)} | history(saved)
    described.write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.export_segmentation", description="Write the fine words."
    )
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--to", type=Path, default=Path("worker/encoders/weights"))
    parser.add_argument("--member", choices=ENSEMBLE, help="which they become; without, the first that they can be")
    options = parser.parse_args(arguments)
    export_segmentation(options.checkpoint, options.to, member=options.member)


if __name__ == "__main__":
    main()
