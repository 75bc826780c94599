"""From a checkpoint to the files that ship.

``python -m training.commands.export --checkpoint FILE --data DATA --to FOLDER`` writes all three, so that they always
belong together:

``compact.safetensors``
    float16. The state dict of ``CompactNetwork(97)``; ``text.vectors`` (n_labels, 97), row i belonging to label i of
    the JSON file; ``text.basis`` (512, 97), orthonormal columns: ``basis @ z`` is the 512-d embedding of a 97-d one,
    and ``text @ basis`` turns a centred 512-d text vector into one for the 97-d field; ``text.centre`` (512,), the
    mean that was taken from CLIP's unit vectors before they were scaled to unit length again.
``compact.onnx``
    Graph for ONNX Runtime, whose weights are those of the first file; see `training.models.onnx_graphs`.
``compact.json``
    ``weights`` and ``graph``: name and SHA-256 of either file. ``terms``: of use, in words. ``words``: for each label
    (`word`) the entries of CLIP's file that its vector is the unit mean of (`clip`), whether labelled pixels could show
    it in training (`trained`), and whether some class stands for it only (`alone`). ``provenance``. The members of the
    segmentation ensemble, which `training.commands.export_segmentation` adds, are kept if the shallow layers and the
    basis are those that the members were trained with.

The cosine of a cell's embedding z (unit length) with label i is ``text.vectors[i] @ z``. The rows are shorter than 1 by
the part of CLIP's vector that lies outside the network's 97 dimensions, and must not be scaled to unit length.
"""

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save_file

from schemas.inference import STRIDE
from training.data.lexicon import ClipVectors, Lexicon
from training.data.sources import CLIP_FILE, find_classes
from training.models.checkpoints import reduced, shared_digest
from training.models.onnx_graphs import write_fields_graph, write_segmentation_graph
from worker.encoders.compact.ensemble import ENSEMBLE
from worker.encoders.compact.network import CLIP_CHANNELS, DETAIL_CHANNELS, REDUCED_CHANNELS

LABELS_TO_SHIP = (
    # Streets.
    *("road", "sidewalk", "parking", "building", "wall", "fence", "pole", "traffic sign", "traffic light"),
    *("vegetation", "trunk", "tree", "terrain", "grass", "sky", "person", "cyclist", "car", "truck", "bus"),
    *("motorcycle", "bicycle", "vehicle", "window", "door", "floor", "ceiling", "other"),
    # The further labels of the authors' list.
    *("ground", "structure", "house", "van", "nature", "human", "bicyclist", "motorcyclist", "object"),
    # Rooms and country, of the default preset.
    *("mountain", "cabinet", "chair", "table", "sofa", "bed"),
    # Often wanted.
    *("stairs", "bench", "bridge", "train", "rider"),
)
"""Labels that ship whether or not a data set names them; every label that one names ships too."""

TERMS = "research and non-commercial use: terms of the data it was trained on, see worker/encoders/weights/README.md"

ORIGIN = {
    "trunk": {
        "file": "deeplab_mobilenet_edgetpu_slim_cityscapes_quant.tflite",
        "repository": "google-coral/test_data",
        "commit": "104342d2",
        "licence": "Apache-2.0",
        "trained on": "Cityscapes (research terms), by its authors",
    },
    "text": {
        "model": "CLIP ViT-B/16 (MIT), template 'a photo of a {word}', centred",
        "repositories": ["google-research/semivl (Apache-2.0)", "ZiqinZhou66/ZegCLIP (MIT)"],
    },
}


def export(checkpoint: Path, data_folder: Path, folder: Path, name: str = "compact", terms: str = TERMS) -> Path:
    """Write the three files into a folder, which is made; returns the path of the weights."""
    saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
    state, basis = reduced(saved["average"])
    clip = ClipVectors(data_folder / CLIP_FILE)
    labels = described_labels(clip, Lexicon(clip, find_classes(data_folder)))
    vectors = torch.from_numpy(clip.matrix([entry["word"] for entry in labels]))
    tensors = {key: tensor.half().contiguous() for key, tensor in state.items()}
    tensors["text.vectors"] = (vectors @ basis).half().contiguous()
    tensors["text.basis"] = basis.half().contiguous()
    tensors["text.centre"] = torch.from_numpy(clip.center).half()
    folder.mkdir(parents=True, exist_ok=True)
    weights = folder / f"{name}.safetensors"
    save_file(tensors, weights)
    weights.chmod(0o644)
    path = folder / f"{name}.json"
    earlier = json.loads(path.read_text()) if path.exists() else {}
    described = {
        "format": 2,
        "weights": name_and_digest(weights),
        "graph": name_and_digest(write_fields_graph(weights)),
        "terms": terms,
        "stride": STRIDE,
        "channels": {"words": REDUCED_CHANNELS, "detail": DETAIL_CHANNELS, "clip": CLIP_CHANNELS},
        "provenance": ORIGIN | history(saved),
        "words": labels,
    }
    for member in ENSEMBLE:
        if member in earlier and earlier[member]["training"]["plan"]["shared"] == shared_digest(tensors):
            described[member] = earlier[member]
    first = ENSEMBLE[0]
    if first in described:  # its graph reads the shallow layers at their offsets in the new file
        graph = write_segmentation_graph(weights, folder / earlier[first]["weights"]["file"])
        described[first] = earlier[first] | {"graph": name_and_digest(graph)}
    path.write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n")
    return weights


def described_labels(clip: ClipVectors, lexicon: Lexicon) -> list[dict[str, Any]]:
    """Describe every label to ship as the JSON file does; see the module's docstring.

    Raises
    ------
    ValueError
        A label has neither a CLIP vector nor stand-ins.
    """
    trained = set(lexicon.labels)
    alone = {each.labels[0] for each in lexicon.classes if len(each.labels) == 1}
    described = []
    for label in dict.fromkeys((*LABELS_TO_SHIP, *lexicon.labels)):
        sources = clip.sources(label)
        if not sources:
            raise ValueError(f"no CLIP vector for the label {label!r}, and no stand-in")
        known = label in trained or all(source in trained for source in sources)
        described.append({"word": label, "clip": list(sources), "trained": known, "alone": label in alone})
    return described


def history(saved: Mapping[str, Any]) -> dict[str, Any]:
    """Describe how long a checkpoint was trained, by what plan, and which run it was averaged with, if any."""
    run = {"training": {"steps": saved["step"], "minutes": round(saved["seconds"] / 60), "plan": saved["plan"]}}
    return run | ({"blended with another run": saved["averaged_with"]} if "averaged_with" in saved else {})


def name_and_digest(path: Path) -> dict[str, str]:
    """Name and SHA-256 of a file, as the JSON file has them."""
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.export", description="Write the weights that ship."
    )
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--to", type=Path, default=Path("worker/encoders/weights"))
    parser.add_argument("--name", default="compact", help="of the encoder, and so of the files")
    parser.add_argument("--terms", default=TERMS, help="terms of use, in words")
    options = parser.parse_args(arguments)
    export(options.checkpoint, options.data, options.to, options.name, options.terms)


if __name__ == "__main__":
    main()
