import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from training.commands.export import export
from training.commands.train_segmentation import main
from training.data.batches import Batches
from training.data.images import Pixels
from training.data.lexicon import Lexicon
from training.data.mix import Mix
from training.data.pseudo_labels import SOFT_LABEL_GRID, Floats16, write_soft_labels
from training.data.sources import find_sources
from training.loop import Run
from training.losses.distillation import distillation_loss_of
from training.losses.label_loss import label_loss_of
from training.losses.segmentation import SegmentationLosses, SegmentationPlan
from training.models.checkpoints import State, load_network, shared_digest
from training.models.initialization import initial_independent_network, initial_segmentation_network
from training.models.network import TrainedNetwork
from training.models.teacher import Teacher
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork

MIX = Mix(strong=0, mild=0, labelled=3, labelled_strong=0.5, labelled_size=(64, 96), labelled_stride=1)


class CertainOfRoad(Teacher):
    def __init__(self) -> None:
        nn.Module.__init__(self)

    def soft_labels(self, image: Pixels) -> Floats16:
        probabilities = np.zeros((19, *SOFT_LABEL_GRID), np.float16)
        probabilities[0] = 1
        return probabilities


@pytest.fixture
def weights(data_folder: Path, tmp_path: Path) -> Path:
    torch.manual_seed(0)
    saved = {"average": TrainedNetwork().state_dict(), "step": 1, "seconds": 1.0, "plan": {}}
    torch.save(saved, tmp_path / "whole.pt")
    export(tmp_path / "whole.pt", data_folder, tmp_path)
    return tmp_path / "compact.safetensors"


def test_the_losses_sink_and_the_network_that_recognises_places_does_not_change(
    weights: Path, data_folder: Path, lexicon: Lexicon, tmp_path: Path
) -> None:
    shared = load_network(weights)
    before = {name: tensor.clone() for name, tensor in shared.state_dict().items()}
    segmentation = initial_segmentation_network(shared)
    sources = find_sources(data_folder, None)
    vectors = torch.randn(len(lexicon.labels), 97) / 10
    losses = label_loss_of(sources, lexicon, vectors), distillation_loss_of(lexicon, vectors)
    plan = SegmentationPlan(steps=15, trunk_rate=1e-3)
    run = Run(segmentation, SegmentationLosses(shared, segmentation, *losses, plan), plan, tmp_path)
    write_soft_labels(CertainOfRoad().soft_labels, [scene[0].image for scene in sources["camvid"].scenes], tmp_path)
    batch = Batches(sources, lexicon, MIX, 5, tmp_path)[0]
    first, parts = run.objective(batch)

    run.train(iter([batch] * 15))

    last, parts_then = run.objective(batch)
    assert last.item() < first.item()
    assert all(parts_then[name].item() < parts[name].item() for name in ("label", "soft_iou", "distillation"))
    assert all(torch.equal(before[name], tensor) for name, tensor in shared.state_dict().items())


def test_the_command_trains_resumes_and_says_which_network_it_began_with(
    weights: Path, data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.commands.train_segmentation.read_trunk", lambda path: {})
    monkeypatch.setattr("training.commands.train_segmentation.Teacher", lambda state: CertainOfRoad())
    (tmp_path / "trunk.npz").touch()
    given = ["--data", str(data_folder), "--trunk", str(tmp_path / "trunk.npz"), "--network", str(weights)]
    given += [
        "--out",
        str(tmp_path / "run"),
        "--height",
        "64",
        "--width",
        "96",
        "--labelled-views",
        "2",
        "--workers",
        "0",
    ]

    main([*given, "--steps", "1"])
    main([*given, "--steps", "2", "--resume"])

    saved = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert saved["step"] == 2
    assert saved["plan"]["shared"] == shared_digest(load_file(weights))
    lines = (tmp_path / "run" / "runs.jsonl").read_text().splitlines()
    assert [json.loads(line)["from step"] for line in lines] == ["0", "1"]


@pytest.fixture
def independent(
    weights: Path, data_folder: Path, trunk: State, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Options of a run that trains an independent network from a trunk, in the folder ``run``."""
    monkeypatch.setattr("training.commands.train_segmentation.read_trunk", lambda path: trunk)
    monkeypatch.setattr("training.commands.train_segmentation.Teacher", lambda state: CertainOfRoad())
    (tmp_path / "trunk.npz").touch()
    given = [
        "--data",
        str(data_folder),
        "--trunk",
        str(tmp_path / "trunk.npz"),
        "--network",
        str(weights),
        "--independent",
    ]
    given += [
        "--out",
        str(tmp_path / "run"),
        "--height",
        "64",
        "--width",
        "96",
        "--labelled-views",
        "2",
        "--workers",
        "0",
    ]
    return given


def test_an_independent_network_begins_with_the_trunk_and_keeps_its_first_layers(
    independent: list[str], trunk: State, tmp_path: Path
) -> None:
    began = initial_independent_network(trunk, torch.randn(19, 97))

    main([*independent, "--zoom", "1", "2", "--steps", "2"])

    trained = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["network"]
    changed = {name for name, tensor in began.state_dict().items() if not torch.equal(tensor, trained[name])}
    assert not any(name.startswith(("shallow.stride2", "shallow.stride4")) for name in changed)
    assert "shallow.stride8.0.convolutions.0.convolution.weight" in changed


def test_an_independent_network_goes_on_from_a_pretrained_one_with_other_shares_of_the_sets(
    independent: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pretrained = {name: torch.full_like(t, 0.01) for name, t in IndependentSegmentationNetwork().state_dict().items()}
    torch.save({"average": pretrained}, tmp_path / "pretrained.pt")
    mixes: list[Mix] = []

    def mix(**numbers: Any) -> Mix:
        mixes.append(Mix(**numbers))
        return mixes[-1]

    monkeypatch.setattr("training.commands.train_segmentation.Mix", mix)
    shares = ["--set-shares", "0.2", "0", "0.7", "0.1"]
    main([*independent, *shares, "--pretrained", str(tmp_path / "pretrained.pt"), "--steps", "1"])

    went_on = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["network"]
    assert all(torch.allclose(tensor, pretrained[name], atol=1e-3) for name, tensor in went_on.items())
    [drawn] = mixes
    assert drawn.labelled_shares == {"camvid": 0.2, "labelmefacade": 0.0, "nyuv2": 0.7, "ade_outdoor": 0.1}


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--set-shares", "0", "0", "0", "0"], "one of them above"),
        (["--set-shares", "1", "-1", "1", "1"], "at least 0"),
        (["--zoom", "2", "1"], "--zoom wants the least, above 0, and the greatest: not 2 1"),
        (["--zoom", "0", "1"], "not 0 1"),
    ],
)
def test_options_that_contradict_one_another_are_refused(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--data", "d", "--trunk", "t", "--network", "w", "--out", str(tmp_path), "--steps", "1"]
    with pytest.raises(SystemExit):
        main([*given, *options])
    assert complaint in capsys.readouterr().err


def test_a_run_of_no_length_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--data", "d", "--trunk", "t.npz", "--network", "w", "--out", str(tmp_path / "o")])
    assert "say how long" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
