"""From a run of steadier words to what ships: ``python -m training.export_steady --checkpoint FILE --to FOLDER``.

It changes the deep layers in the exported weights that the run began with, and names the new SHA-256 in
``compact.json``. The shallow layers, the heads, the text vectors and so the fine words stay as they are.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from training.export import check_shared, history, named
from training.export_onnx import write_fields_graph, write_fine_graph


def export_steady(checkpoint: Path, folder: Path, name: str = "compact") -> None:
    """Write the weights and the graphs that read them, and renew what the JSON file says of them.

    Raises
    ------
    ValueError
        The run began with other weights than those in `folder`.
    """
    saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
    described = folder / f"{name}.json"
    facts = json.loads(described.read_text())
    weights = folder / facts["weights"]["file"]
    check_shared(saved, checkpoint, weights)
    tensors = load_file(weights) | {key: tensor.half().contiguous() for key, tensor in saved["average"].items()}
    save_file(tensors, weights)
    weights.chmod(0o644)
    facts |= {"weights": named(weights), "graph": named(write_fields_graph(weights))}
    facts["provenance"]["steadier words"] = history(saved)
    if "fine" in facts:
        fine = folder / facts["fine"]["weights"]["file"]
        facts["fine"]["graph"] = named(write_fine_graph(weights, fine))
    described.write_text(json.dumps(facts, indent=1, ensure_ascii=False) + "\n")


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.export_steady", description="Write steadier words.")
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--to", type=Path, default=Path("worker/encoders/weights"))
    options = parser.parse_args(arguments)
    export_steady(options.checkpoint, options.to)


if __name__ == "__main__":
    main()
