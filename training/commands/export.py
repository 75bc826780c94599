"""From a checkpoint to what ships: ``python -m training.commands.export --checkpoint FILE --data DATA --to FOLDER``.

Three files come out, and one command makes all of them, so they cannot drift apart:

``compact.safetensors``
    float16. The state dict of ``CompactNetwork(word_channels=97)``; ``text.vectors`` (n_words, 97), row i belonging to
    word i of the JSON file; ``text.basis`` (512, 97), orthonormal columns: ``basis @ z`` is the 512-d embedding of a
    97-d one, and ``text @ basis`` turns a centred 512-d text vector into a row for the 97-d field; ``text.centre``
    (512,), the mean that was taken from CLIP's unit vectors before they were scaled to unit length again.
``compact.onnx``
    Graph for ONNX Runtime, whose weights are those of the first file; see `training.models.onnx_graphs`.
``compact.json``
    ``weights`` and ``graph``: name and SHA-256 of either file; ``words``: for each its CLIP words (`clip`: several mean
    their unit mean), whether labelled pixels could mean it in training (`trained`) and whether some could mean only it
    (`alone`); ``provenance``. `training.commands.export_segmentation` adds the READERS of segmentation network, which are kept as long as the
    shallow layers and the basis stay what they were.

The cosine of a cell's embedding z (unit length) with word i is ``text.vectors[i] @ z``: the rows are shorter than 1
by what of CLIP's vector lies outside the network's 97 dimensions, and must not be scaled.
"""

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from training.data import batches as data
from training.data.lexicon import ClipWords, Lexicon
from training.models.network import TAUGHT_THROUGH
from training.models.onnx_graphs import shipped_network, write_fields_graph, write_segmentation_graph
from worker.encoders.compact.encoder import ENSEMBLE
from worker.encoders.compact.network import CLIP_CHANNELS, DETAIL_CHANNELS, REDUCED_CHANNELS, STRIDE, CompactNetwork

WORDS_TO_SHIP = (
    # Streets.
    *("road", "sidewalk", "parking", "building", "wall", "fence", "pole", "traffic sign", "traffic light"),
    *("vegetation", "trunk", "tree", "terrain", "grass", "sky", "person", "cyclist", "car", "truck", "bus"),
    *("motorcycle", "bicycle", "vehicle", "window", "door", "floor", "ceiling", "other"),
    # The further words of the authors' list.
    *("ground", "structure", "house", "van", "nature", "human", "bicyclist", "motorcyclist", "object"),
    # Often asked for.
    *("stairs", "bench", "bridge", "train", "rider"),
)
"""Words that ship whether or not a data set names them; every word that one names ships too."""

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


def reduced(state: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], Tensor]:
    """Shorten the 512-d words head to the 97 dimensions it spans, keeping every length and cosine; leave `refine` out.

    An embedding is e = W y + b with a 96-d y. With [W b] = U S V' (singular values) the vector z = S V' [y; 1] has
    e = U z and, U having orthonormal columns, the same lengths and cosines.

    Parameters
    ----------
    state
        State dict of ``TrainedNetwork()``.

    Returns
    -------
    state
        State dict of ``CompactNetwork(word_channels=97)``.
    basis : float32 of shape (512, 97)
        U.
    """
    weight, bias = state["words.weight"], state["words.bias"]
    whole = torch.cat([weight.flatten(1), bias[:, None]], dim=1).double()
    basis, lengths, turned = torch.linalg.svd(whole, full_matrices=False)
    short = (lengths[:, None] * turned).float()
    smaller = {name: tensor for name, tensor in state.items() if not name.startswith(TAUGHT_THROUGH)}
    smaller["words.weight"] = short[:, :-1, None, None].contiguous()
    smaller["words.bias"] = short[:, -1].contiguous()
    return smaller, basis.float()


def shipped_words(clip: ClipWords, lexicon: Lexicon) -> list[dict[str, Any]]:
    """Describe every word to ship; see the module's docstring."""
    shared = set(lexicon.words)
    alone = {meaning.words[0] for meaning in lexicon.meanings if len(meaning.words) == 1}
    described = []
    for word in dict.fromkeys((*WORDS_TO_SHIP, *lexicon.words)):
        sources = clip.sources(word)
        if not sources:
            raise ValueError(f"no CLIP vector for the word {word!r}, and no stand-in")
        trained = word in shared or all(source in shared for source in sources)
        described.append({"word": word, "clip": list(sources), "trained": trained, "alone": word in alone})
    return described


def export(checkpoint: Path, data_folder: Path, folder: Path, name: str = "compact") -> None:
    """Write the weights, and the graph and the JSON file beside them."""
    saved = torch.load(checkpoint, map_location="cpu", weights_only=True)
    state, basis = reduced(saved["average"])
    clip = ClipWords(data_folder / data.CLIP_FILE)
    words = shipped_words(clip, Lexicon(clip, data.classes(data_folder)))
    vectors = torch.from_numpy(clip.matrix([entry["word"] for entry in words]))
    tensors = {key: tensor.half().contiguous() for key, tensor in state.items()}
    tensors["text.vectors"] = (vectors @ basis).half().contiguous()
    tensors["text.basis"] = basis.half().contiguous()
    tensors["text.centre"] = torch.from_numpy(clip.centre).half()
    folder.mkdir(parents=True, exist_ok=True)
    weights = folder / f"{name}.safetensors"
    save_file(tensors, weights)
    weights.chmod(0o644)
    path = folder / f"{name}.json"
    earlier = json.loads(path.read_text()) if path.exists() else {}
    described = {
        "format": 2,
        "weights": named(weights),
        "graph": named(write_fields_graph(weights)),
        "stride": STRIDE,
        "channels": {"words": REDUCED_CHANNELS, "detail": DETAIL_CHANNELS, "clip": CLIP_CHANNELS},
        "provenance": ORIGIN | history(saved),
        "words": words,
    }
    for member in ENSEMBLE:
        if member in earlier and earlier[member]["training"]["plan"]["shared"] == shared_digest(tensors):
            described[member] = earlier[member]
    if "fine" in described:  # its graph reads the shallow layers at their places in the new file
        graph = write_segmentation_graph(weights, folder / earlier["fine"]["weights"]["file"])
        described["fine"] = earlier["fine"] | {"graph": named(graph)}
    path.write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n")


def shared_digest(tensors: Mapping[str, Tensor]) -> str:
    """SHA-256 of the exported tensors that segmentation network build on: the shallow layers and the basis."""
    digest = hashlib.sha256()
    for name in sorted(tensors):
        if name.startswith(("stride2.", "stride4.", "stride8.", "text.basis")):
            digest.update(name.encode())
            digest.update(tensors[name].contiguous().numpy().tobytes())
    return digest.hexdigest()


def history(saved: Mapping[str, Any]) -> dict[str, Any]:
    """How long a checkpoint was trained and by what plan, and what run it was averaged with, if with any."""
    run = {"training": {"steps": saved["step"], "minutes": round(saved["seconds"] / 60), "plan": saved["plan"]}}
    return run | ({"blended with another run": saved["blended"]} if "blended" in saved else {})


def named(path: Path) -> dict[str, str]:
    """Name and SHA-256 of a file, as the JSON file has them."""
    return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}


def network_of(path: Path) -> CompactNetwork:
    """Load a network to judge: a checkpoint's averaged weights (``.pt``) or an exported file."""
    return CompactNetwork.loaded(_averaged(path)[0]) if path.suffix == ".pt" else shipped_network(path)


def basis_of(path: Path) -> Tensor:
    """Load the basis, float32 of shape (512, 97), that belongs to such a network's words field."""
    return _averaged(path)[1] if path.suffix == ".pt" else load_file(path)["text.basis"].float()


def _averaged(checkpoint: Path) -> tuple[dict[str, Tensor], Tensor]:
    return reduced(torch.load(checkpoint, map_location="cpu", weights_only=True)["average"])


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.export", description="Write the weights that ship."
    )
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--to", type=Path, default=Path("worker/encoders/weights"))
    options = parser.parse_args(arguments)
    export(options.checkpoint, options.data, options.to)


if __name__ == "__main__":
    main()
