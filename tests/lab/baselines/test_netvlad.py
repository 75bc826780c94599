"""NetVLAD: the layouts of its files, and parity with the reference implementation's own output."""

import importlib.util
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from lab.baselines.netvlad import NetVlad, NetVladBaseline, load
from schemas.errors import SetupError


@pytest.fixture(scope="module")
def reference(shared: Path) -> Path:
    return shared / "netvlad-parity"


@pytest.fixture(scope="module")
def writer(reference: Path) -> Any:
    spec = importlib.util.spec_from_file_location("make_random_checkpoint", reference / "make_random_checkpoint.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
@pytest.mark.shared
def test_parity_with_the_reference(reference: Path, writer: Any, tmp_path: Path) -> None:
    torch.save(writer.checkpoint(0, "full"), tmp_path / "checkpoint.pth.tar")
    baseline = NetVladBaseline(tmp_path / "checkpoint.pth.tar")
    expected = np.load(reference / "expected.npz")
    for name, file in (("a", "a_320x240.png"), ("b", "b_411x173.png")):
        got = baseline.describe(reference / file)
        want = expected[f"{name}_descriptor"]
        # The reference's own noise is 1.9e-6 and 6.3e-8; the smallest mistake listed in its readme costs 0.024.
        assert np.linalg.norm(got.astype(np.float64) - want) <= 2e-5
        assert np.abs(got - want).max() <= 1e-6


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize(("form", "legacy"), [("state-dict", False), ("data-parallel", False), ("full", True)])
def test_every_form_of_the_published_file_is_read(writer: Any, tmp_path: Path, form: str, legacy: bool) -> None:
    path = tmp_path / "model_best.pth.tar"
    content = writer.checkpoint(0, form)
    if legacy:
        old = writer.OldNumpyPickle
        torch.save(content, path, pickle_module=old, pickle_protocol=2, _use_new_zipfile_serialization=False)
    else:
        torch.save(content, path)
    weight = load(path).state_dict()["encoder.28.weight"]
    assert np.array_equal(weight.numpy(), writer.tensors(0)["encoder.28.weight"])


@pytest.fixture(scope="module")
def tensors() -> "OrderedDict[str, torch.Tensor]":
    torch.manual_seed(0)
    network = NetVlad(clusters=4)
    with torch.no_grad():
        network.pool.centroids.normal_()
    return OrderedDict(network.state_dict())


def test_names_are_those_of_the_published_file(tensors: "OrderedDict[str, torch.Tensor]") -> None:
    convolutions = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    names = {f"encoder.{i}.{part}" for i in convolutions for part in ("weight", "bias")}
    assert set(tensors) == names | {"pool.conv.weight", "pool.centroids"}


def test_odd_sizes_are_floored_and_vectors_have_length_one(tensors: "OrderedDict[str, torch.Tensor]") -> None:
    network = NetVlad(clusters=4).eval()
    network.load_state_dict(tensors)
    with torch.inference_mode():
        image = torch.rand(1, 3, 35, 67, generator=torch.Generator().manual_seed(0))
        assert network.features(image).shape == (1, 512, 2, 4)
        assert torch.linalg.vector_norm(network(image)).item() == pytest.approx(1, abs=1e-5)


def test_matrix_form_equals_the_sum_over_cells(tensors: "OrderedDict[str, torch.Tensor]") -> None:
    network = NetVlad(clusters=4).eval()
    network.load_state_dict(tensors)
    with torch.inference_mode():
        image = torch.rand(1, 3, 48, 48, generator=torch.Generator().manual_seed(1))
        features = network.features(image)
        share = network.logits(features)[0].flatten(1).softmax(0).numpy()
        cells = features[0].flatten(1).numpy()
        cells = cells / np.linalg.norm(cells, axis=0)
        centres = network.pool.centroids.numpy()
        rows = np.zeros((4, 512))
        for k in range(4):
            for x in range(cells.shape[1]):
                rows[k] += share[k, x] * (cells[:, x] - centres[k])
        rows /= np.linalg.norm(rows, axis=1, keepdims=True)
        want = rows.ravel() / np.linalg.norm(rows)
        assert network(image)[0].numpy() == pytest.approx(want, abs=1e-6)


def test_other_peoples_names_and_whitening(tensors: "OrderedDict[str, torch.Tensor]", tmp_path: Path) -> None:
    def renamed(name: str) -> str:
        return name.replace("encoder.", "module.backbone.").replace("pool.", "module.aggregation.")

    benchmark = {renamed(name): value for name, value in tensors.items()}
    torch.save({"model_state_dict": benchmark}, tmp_path / "benchmark.pth")
    patch = {**tensors, "WPCA.0.weight": torch.zeros(8, 4 * 512, 1, 1), "WPCA.0.bias": torch.zeros(8)}
    torch.save({"num_pcs": 8, "state_dict": patch}, tmp_path / "patch.pth")
    for path in tmp_path.iterdir():
        assert torch.equal(load(path).state_dict()["pool.centroids"], tensors["pool.centroids"])


def test_the_bias_of_vladv2_is_not_ignored(tensors: "OrderedDict[str, torch.Tensor]", tmp_path: Path) -> None:
    torch.save({**tensors, "pool.conv.bias": torch.tensor([5.0, 0, 0, 0])}, tmp_path / "v2.pth")
    network = load(tmp_path / "v2.pth")
    features = torch.ones(1, 512, 1, 1)
    plain = NetVlad(clusters=4)
    plain.load_state_dict(tensors)
    difference = (network.logits(features) - plain.logits(features)).flatten()
    assert difference.detach().numpy() == pytest.approx([5, 0, 0, 0], abs=1e-5)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda t: t.pop("encoder.5.bias"), "encoder.5.bias is missing"),
        (lambda t: t.update(extra=torch.zeros(1)), "extra is not known"),
        (lambda t: t.update({"encoder.0.weight": torch.zeros(1)}), "encoder.0.weight has shape"),
        (lambda t: t.pop("pool.centroids"), "no tensor pool.centroids"),
    ],
)
def test_a_wrong_file_is_explained(
    tensors: "OrderedDict[str, torch.Tensor]", tmp_path: Path, spoil: Any, says: str
) -> None:
    content = OrderedDict(tensors)
    spoil(content)
    torch.save(content, tmp_path / "wrong.pth")
    with pytest.raises(SetupError, match=says):
        load(tmp_path / "wrong.pth")


class Trap:
    """What unsafe loading would run."""

    def __reduce__(self) -> Any:
        return exec, ("raise SystemExit('code of the file was run')",)


def test_code_in_a_file_is_not_run(tmp_path: Path) -> None:
    torch.save({"state_dict": Trap()}, tmp_path / "trap.pth")
    with pytest.raises(SetupError, match="cannot be read"):
        load(tmp_path / "trap.pth")
    with pytest.raises(SetupError, match="no such file"):
        load(tmp_path / "none.pth")
