import hashlib
import json
from pathlib import Path

import torch
from safetensors.torch import load_file

from training.export import WORDS_TO_SHIP, export, network_of, reduced
from worker.encoders.compact_network import CompactNetwork

WEIGHTS = Path(__file__).parents[2] / "worker" / "encoders" / "weights"

THE_PAPERS_WORDS = (
    *("road", "sidewalk", "building", "vehicle", "car", "bicycle", "motorcycle", "vegetation", "trunk", "terrain"),
    *("cyclist", "pole", "sky", "other"),
)
THE_AUTHORS_WORDS = (
    *("ground", "road", "sidewalk", "parking", "structure", "building", "house", "vehicle", "car", "truck", "van"),
    *("bicycle", "motorcycle", "nature", "vegetation", "trunk", "terrain", "tree", "human", "person", "cyclist"),
    *("bicyclist", "motorcyclist", "object", "fence", "pole", "traffic sign", "sky", "other"),
)


def checkpoint_in(folder: Path) -> tuple[Path, CompactNetwork]:
    torch.manual_seed(0)
    network = CompactNetwork(512).eval()
    path = folder / "checkpoint.pt"
    torch.save({"average": network.state_dict(), "step": 3, "seconds": 60.0, "plan": {}}, path)
    return path, network


def test_the_reduced_network_keeps_every_cosine() -> None:
    torch.manual_seed(0)
    whole = CompactNetwork(512).eval()
    state, basis = reduced(whole.state_dict())
    small = CompactNetwork(97).eval()
    small.load_state_dict(state)
    picture = torch.rand(1, 3, 64, 64)

    with torch.inference_mode():
        wide = whole(picture)[0][0].flatten(1).T
        narrow = small(picture)[0][0].flatten(1).T

    assert torch.allclose(wide, narrow @ basis.T, atol=1e-5)
    assert torch.allclose(wide @ wide.T, narrow @ narrow.T, atol=1e-5)
    assert torch.allclose(basis.T @ basis, torch.eye(97), atol=1e-5)


def test_the_exported_file_answers_like_the_checkpoint_to_half_precision(data_folder: Path, tmp_path: Path) -> None:
    checkpoint, whole = checkpoint_in(tmp_path)
    export(checkpoint, data_folder, tmp_path / "weights")
    shipped = network_of(tmp_path / "weights" / "compact.safetensors")
    text = load_file(tmp_path / "weights" / "compact.safetensors")
    picture = torch.rand(1, 3, 64, 64)

    with torch.inference_mode():
        wide, detail = whole(picture)
        narrow, same_detail = shipped(picture)
    again = torch.einsum("dc,nchw->ndhw", text["text.basis"].float(), narrow)

    assert float((again * wide).sum(dim=1).min()) > 0.999
    assert float((same_detail * detail).sum(dim=1).min()) > 0.999


def test_the_words_file_says_where_each_word_comes_from(data_folder: Path, tmp_path: Path) -> None:
    checkpoint, _ = checkpoint_in(tmp_path)

    export(checkpoint, data_folder, tmp_path)

    described = json.loads((tmp_path / "compact.json").read_text())
    words = {entry["word"]: entry for entry in described["words"]}
    assert set(WORDS_TO_SHIP) <= set(words)
    assert words["vehicle"]["clip"] == ["car", "truck", "bus", "motorcycle"]
    assert (words["street"]["trained"], words["street"]["alone"]) == (True, False)
    assert (words["sky"]["trained"], words["sky"]["alone"]) == (True, True)
    assert not words["ceiling"]["trained"]


class TestShippedWeights:
    def test_the_sums_are_right(self) -> None:
        described = json.loads((WEIGHTS / "compact.json").read_text())
        sums = {described["weights"]: described["sha256"]}
        sums |= {graph["file"]: graph["sha256"] for graph in described["graphs"].values()}

        assert len(sums) == 3
        for name, sha256 in sums.items():
            assert hashlib.sha256((WEIGHTS / name).read_bytes()).hexdigest() == sha256

    def test_every_word_has_a_row(self) -> None:
        described = json.loads((WEIGHTS / "compact.json").read_text())
        text = load_file(WEIGHTS / described["weights"])

        assert text["text.vectors"].shape == (len(described["words"]), 97)
        assert {*THE_PAPERS_WORDS, *THE_AUTHORS_WORDS} <= {entry["word"] for entry in described["words"]}

    def test_they_fit_the_network_and_weigh_little(self) -> None:
        network = network_of(WEIGHTS / "compact.safetensors")

        assert sum(tensor.numel() for tensor in network.parameters()) < 3_000_000
        assert sum(path.stat().st_size for path in WEIGHTS.iterdir()) < 25_000_000
