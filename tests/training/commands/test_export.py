import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from schemas.description import Floats
from schemas.image import Image
from training.commands.export import LABELS_TO_SHIP, export
from training.commands.export_segmentation import export_segmentation
from training.models.checkpoints import load_network, reduced, shared_digest
from training.models.initialization import initial_segmentation_network
from training.models.network import TrainedNetwork
from worker.encoders.compact.encoder import CompactEncoder
from worker.encoders.compact.ensemble import ENSEMBLE
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

WEIGHTS = Path(__file__).parents[3] / "worker" / "encoders" / "weights"

PAPER_LABELS = (
    *("road", "sidewalk", "building", "vehicle", "car", "bicycle", "motorcycle", "vegetation", "trunk", "terrain"),
    *("cyclist", "pole", "sky", "other"),
)
AUTHORS_LABELS = (
    *("ground", "road", "sidewalk", "parking", "structure", "building", "house", "vehicle", "car", "truck", "van"),
    *("bicycle", "motorcycle", "nature", "vegetation", "trunk", "terrain", "tree", "human", "person", "cyclist"),
    *("bicyclist", "motorcyclist", "object", "fence", "pole", "traffic sign", "sky", "other"),
)


def checkpoint_in(folder: Path) -> tuple[Path, TrainedNetwork]:
    torch.manual_seed(0)
    network = TrainedNetwork().eval()
    path = folder / "checkpoint.pt"
    torch.save({"average": network.state_dict(), "step": 3, "seconds": 60.0, "plan": {}}, path)
    return path, network


def test_the_reduced_network_keeps_every_cosine() -> None:
    torch.manual_seed(0)
    whole = TrainedNetwork().eval()
    state, basis = reduced(whole.state_dict())
    small = CompactNetwork(97).eval()
    small.load_state_dict(state)
    image = torch.rand(1, 3, 64, 64)

    with torch.inference_mode():
        wide = whole(image)[0][0].flatten(1).T
        narrow = small(image)[0][0].flatten(1).T

    assert torch.allclose(wide, narrow @ basis.T, atol=1e-5)
    assert torch.allclose(wide @ wide.T, narrow @ narrow.T, atol=1e-5)
    assert torch.allclose(basis.T @ basis, torch.eye(97), atol=1e-5)


def test_the_exported_file_answers_like_the_checkpoint_to_half_precision(data_folder: Path, tmp_path: Path) -> None:
    checkpoint, whole = checkpoint_in(tmp_path)
    export(checkpoint, data_folder, tmp_path / "weights")
    shipped = load_network(tmp_path / "weights" / "compact.safetensors")
    text = load_file(tmp_path / "weights" / "compact.safetensors")
    image = torch.rand(1, 3, 64, 64)

    with torch.inference_mode():
        wide, detail = whole(image)
        narrow, same_detail = shipped(image)
    again = torch.einsum("dc,nchw->ndhw", text["text.basis"].float(), narrow)

    assert float((again * wide).sum(dim=1).min()) > 0.999
    assert float((same_detail * detail).sum(dim=1).min()) > 0.999


def test_the_json_file_says_what_each_label_is_made_of(data_folder: Path, tmp_path: Path) -> None:
    checkpoint, _ = checkpoint_in(tmp_path)

    export(checkpoint, data_folder, tmp_path)

    described = json.loads((tmp_path / "compact.json").read_text())
    labels = {entry["word"]: entry for entry in described["words"]}
    assert set(LABELS_TO_SHIP) <= set(labels)
    assert labels["vehicle"]["clip"] == ["car", "truck", "bus", "motorcycle"]
    assert (labels["street"]["trained"], labels["street"]["alone"]) == (True, False)
    assert (labels["sky"]["trained"], labels["sky"]["alone"]) == (True, True)
    assert not labels["ceiling"]["trained"]


def test_a_member_of_the_ensemble_is_added_to_the_network_that_it_was_trained_with_and_to_no_other(
    data_folder: Path, tmp_path: Path
) -> None:
    checkpoint, network = checkpoint_in(tmp_path)
    export(checkpoint, data_folder, tmp_path)
    began_with = shared_digest(load_file(tmp_path / "compact.safetensors"))
    first = initial_segmentation_network(load_network(tmp_path / "compact.safetensors"))
    saved = {"average": first.state_dict(), "step": 3, "seconds": 60.0, "plan": {"shared": began_with}}
    twin = {"share": 0.5, "steps": 7, "minutes": 2}
    torch.save(saved | {"averaged_with": twin}, tmp_path / "first.pt")
    torch.save(saved | {"plan": {"shared": "0" * 64}}, tmp_path / "other.pt")

    with pytest.raises(ValueError, match="began with shallow layers of SHA-256 00000000"):
        export_segmentation(tmp_path / "other.pt", tmp_path)
    export_segmentation(tmp_path / "first.pt", tmp_path)

    described = json.loads((tmp_path / "compact.json").read_text())["fine"]
    assert described["training"]["steps"] == 3
    assert described["blended with another run"] == twin
    assert segmented(tmp_path).shape == (2 * 320 // 8, 480 // 4, 97)

    def export_again(changed: str) -> None:
        with torch.no_grad():
            network.get_parameter(changed).add_(0.01)
        torch.save(torch.load(checkpoint) | {"average": network.state_dict()}, checkpoint)
        export(checkpoint, data_folder, tmp_path)

    first_alone = segmented(tmp_path)
    torch.save(saved | {"average": IndependentSegmentationNetwork().state_dict()}, tmp_path / "second.pt")
    export_segmentation(tmp_path / "second.pt", tmp_path)
    export_segmentation(tmp_path / "second.pt", tmp_path, member="third")
    for wrong, member in (("second.pt", "fine"), ("first.pt", "third")):
        with pytest.raises(ValueError, match=f"it cannot be the member {member}"):
            export_segmentation(tmp_path / wrong, tmp_path, member=member)
    all_three = segmented(tmp_path)
    assert not np.allclose(all_three, first_alone)
    export_again("stride16.0.convolutions.0.convolution.weight")
    assert np.array_equal(segmented(tmp_path), all_three)
    export_again("stride8.0.convolutions.0.convolution.weight")
    assert json.loads((tmp_path / "compact.json").read_text()).keys().isdisjoint(ENSEMBLE)


def segmented(folder: Path) -> Floats:
    """A grey image as the exported ensemble embeds it."""
    segmenter = CompactEncoder(weights=folder / "compact.safetensors").segmenter()
    assert segmenter is not None
    return segmenter.segment(Image.of(np.full((64, 96, 3), 90, np.uint8))).semantic


class TestShippedWeights:
    def test_the_sums_are_right(self) -> None:
        described = json.loads((WEIGHTS / "compact.json").read_text())
        files = [part[kind] for part in (described, *map(described.get, ENSEMBLE)) for kind in ("weights", "graph")]

        assert len({file["file"] for file in files}) == 8
        for file in files:
            assert hashlib.sha256((WEIGHTS / file["file"]).read_bytes()).hexdigest() == file["sha256"]

    def test_the_ensemble_belongs_to_them(self) -> None:
        described = json.loads((WEIGHTS / "compact.json").read_text())

        shared = shared_digest(load_file(WEIGHTS / "compact.safetensors"))
        assert [described[member]["training"]["plan"]["shared"] for member in ENSEMBLE] == [shared] * 3

    def test_every_label_has_a_row(self) -> None:
        described = json.loads((WEIGHTS / "compact.json").read_text())
        text = load_file(WEIGHTS / described["weights"]["file"])

        assert text["text.vectors"].shape == (len(described["words"]), 97)
        assert {*PAPER_LABELS, *AUTHORS_LABELS} <= {entry["word"] for entry in described["words"]}

    def test_they_fit_the_network_and_weigh_little(self) -> None:
        network = load_network(WEIGHTS / "compact.safetensors")

        first = SegmentationNetwork.loaded(load_file(WEIGHTS / "compact-fine.safetensors"))
        others = [
            IndependentSegmentationNetwork.loaded(load_file(WEIGHTS / f"compact-{member}.safetensors"))
            for member in ENSEMBLE[1:]
        ]

        assert sum(tensor.numel() for part in (network, first, *others) for tensor in part.parameters()) < 10_000_000
        sizes = {path.name: path.stat().st_size for path in WEIGHTS.iterdir()}
        open_weights = sum(size for name, size in sizes.items() if name.startswith("compact-open"))
        assert sum(sizes.values()) - open_weights < 25_000_000
        impostors = sizes.pop("compact.impostors.safetensors"), sizes.pop("compact-open.impostors.safetensors")
        assert 0 < max(impostors) < 2_800_000
        assert 0 < open_weights - impostors[1] < 6_000_000  # an encoder of its own, beside the one with an ensemble
