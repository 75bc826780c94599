"""From a checkpoint of fine words to what ships: ``python -m training.export_fine --checkpoint FILE --to FOLDER``.

Beside the exported weights that the run began with it writes ``compact-fine.safetensors`` (float16: the state dict of
``FineWords(97)``) and ``compact-fine.onnx``, and names both, with their SHA-256, under ``fine`` in ``compact.json``.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from training.export import history, named, shared_digest
from training.export_onnx import write_fine_graph


def export_fine(checkpoint: Path, folder: Path, name: str = "compact") -> None:
    """Write the fine words and their graph, and add them to the JSON file.

    Raises
    ------
    ValueError
        The run began with other weights than those in `folder`, whose shallow layers are not the ones it learned on.
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
    fine = folder / f"{name}-fine.safetensors"
    save_file({key: tensor.half().contiguous() for key, tensor in saved["average"].items()}, fine)
    fine.chmod(0o644)
    facts["fine"] = {
        "weights": named(fine),
        "graph": named(write_fine_graph(weights, fine)),
    } | history(saved)
    described.write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.export_fine", description="Write the fine words.")
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--to", type=Path, default=Path("worker/encoders/weights"))
    options = parser.parse_args(arguments)
    export_fine(options.checkpoint, options.to)


if __name__ == "__main__":
    main()
