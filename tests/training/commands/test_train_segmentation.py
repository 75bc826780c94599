import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from training.commands.export import export, network_of, shared_digest
from training.commands.train_segmentation import LabelledPixels, SegmentationPlan, main, started_from
from training.data import batches as data
from training.data.images import Image
from training.data.lexicon import ClipWords, Lexicon
from training.data.mix import Mix
from training.loop import Run
from training.losses.distillation import opinion_loss_of
from training.losses.label_loss import word_loss_of
from training.models.initialization import State, second_started
from training.models.network import TrainedNetwork
from training.models.teacher import OPINION_CELLS, Floats16, Teacher, write_opinions
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork

MIX = Mix(strong=0, mild=0, clear=3, clear_strong=0.5, clear_size=(64, 96), clear_stride=1)


class SureOfRoad(Teacher):
    def __init__(self) -> None:
        nn.Module.__init__(self)

    def opinions(self, image: Image) -> Floats16:
        attributes = np.zeros((19, *OPINION_CELLS), np.float16)
        attributes[0] = 1
        return attributes


@pytest.fixture
def weights(data_folder: Path, tmp_path: Path) -> Path:
    torch.manual_seed(0)
    saved = {"average": TrainedNetwork().state_dict(), "step": 1, "seconds": 1.0, "plan": {}}
    torch.save(saved, tmp_path / "whole.pt")
    export(tmp_path / "whole.pt", data_folder, tmp_path)
    return tmp_path / "compact.safetensors"


def test_the_losses_sink_and_what_places_are_recognised_by_does_not_change(
    weights: Path, data_folder: Path, tmp_path: Path
) -> None:
    shared = network_of(weights)
    before = {name: tensor.clone() for name, tensor in shared.state_dict().items()}
    fine = started_from(shared)
    found, clip = data.sources(data_folder, None), ClipWords(data_folder / data.CLIP_FILE)
    lexicon = Lexicon(clip, data.classes(data_folder))
    vectors = torch.randn(len(lexicon.words), 97) / 10
    losses = word_loss_of(found, lexicon, vectors), opinion_loss_of(lexicon, vectors)
    plan = SegmentationPlan(steps=15, trunk_rate=1e-3)
    run = Run(fine, LabelledPixels(shared, fine, *losses, plan), plan, tmp_path)
    write_opinions(SureOfRoad(), [scene[0].image for scene in found["camvid"].scenes], tmp_path)
    batch = data.Batches(found, lexicon, MIX, 5, tmp_path)[0]
    first, parts = run.objective(batch)

    run.train(iter([batch] * 15))

    last, parts_then = run.objective(batch)
    assert last.item() < first.item()
    assert all(parts_then[name].item() < parts[name].item() for name in ("word", "overlap", "opinion"))
    assert all(torch.equal(before[name], tensor) for name, tensor in shared.state_dict().items())


def test_a_batch_of_single_views_has_nothing_else_and_mixes_the_light(data_folder: Path) -> None:
    found = data.sources(data_folder, None)
    lexicon = Lexicon(ClipWords(data_folder / data.CLIP_FILE), data.classes(data_folder))
    batches = data.Batches(found, lexicon, MIX, seed=5)

    assert batches[0].keys() == {"clear_pictures", "clear_meanings", "clear_sets"}
    assert torch.equal(batches[0]["clear_pictures"], batches[0]["clear_pictures"])
    in_mild_light = data.Batches(found, lexicon, Mix(strong=0, mild=0, clear=3, clear_size=(64, 96)), seed=5)
    assert not torch.equal(in_mild_light[0]["clear_pictures"], batches[0]["clear_pictures"])


def test_things_in_front_are_pasted_with_their_labels(data_folder: Path) -> None:
    """Two of the streets have a bright lorry before a dark building; pasting brings it onto the others' roads."""
    folder = data_folder / "segmentation" / "camvid"
    classes = json.loads((folder / "classes.json").read_text()) | {"3": ["truck"], "4": ["building"]}
    (folder / "classes.json").write_text(json.dumps(classes))
    for number in (0, 1):
        image, labels = np.full((96, 128, 3), 40, np.uint8), np.full((96, 128), 4, np.uint8)
        image[40:60, 50:80], labels[40:60, 50:80] = 250, 3
        cv2.imwrite(str(folder / "train" / "images" / f"{number}.jpg"), image)
        cv2.imwrite(str(folder / "train" / "labels" / f"{number}.png"), labels)
    found = data.sources(data_folder, None)
    lexicon = Lexicon(ClipWords(data_folder / data.CLIP_FILE), data.classes(data_folder))
    spoken = [meaning.words for meaning in lexicon.meanings]
    lorry, road = spoken.index(("truck",)), spoken.index(("road", "street"))

    def brightness(pasted: float) -> list[tuple[float, float]]:
        """Of lorry and road, in every view that shows both."""
        mix = replace(MIX, clear_strong=0.0, clear_pasted=pasted, clear=24)
        batch = data.Batches(found, lexicon, mix, seed=5)[0]
        seen = zip(batch["clear_meanings"], batch["clear_pictures"].float().mean(dim=1), strict=True)
        return [
            (bright[attributes == lorry].mean().item(), bright[attributes == road].mean().item())
            for attributes, bright in seen
            if (attributes == lorry).any() and (attributes == road).any()
        ]

    assert not brightness(0.0)
    together = brightness(1.0)
    assert together
    assert all(of_lorry > of_road for of_lorry, of_road in together)


def test_validation_pictures_are_learned_from_only_when_asked_for(data_folder: Path) -> None:
    folder = data_folder / "segmentation" / "camvid"
    for kind in ("images", "labels"):
        (folder / "val" / kind).mkdir(parents=True)
        first = sorted((folder / "train" / kind).glob("*"))[0]
        shutil.copy(first, folder / "val" / kind / first.name)

    usual, more = (
        data.sources(data_folder, None, splits)["camvid"].scenes for splits in (("train",), ("train", "val"))
    )

    assert len(more) == len(usual) + 1
    assert more[-1][0].image.parent == folder / "val" / "images"
    assert more[-1][0].labels is not None
    assert more[-1][0].labels.exists()


def test_a_network_without_some_layer_is_refused() -> None:
    network = TrainedNetwork()
    del network.stride16[0]

    with pytest.raises((ValueError, RuntimeError)):
        started_from(network)


def test_the_command_trains_goes_on_and_says_which_weights_it_began_with(
    weights: Path, data_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("training.commands.train_segmentation.trunk_state", lambda path: {})
    monkeypatch.setattr("training.commands.train_segmentation.Teacher", lambda state: SureOfRoad())
    given = ["--data", str(data_folder), "--trunk", "trunk.npz", "--weights", str(weights)]
    given += ["--out", str(tmp_path / "run"), "--height", "64", "--width", "96", "--views", "2", "--loaders", "0"]

    main([*given, "--steps", "1"])
    main([*given, "--steps", "2", "--resume"])

    saved = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)
    assert saved["step"] == 2
    assert saved["plan"]["shared"] == shared_digest(load_file(weights))
    lines = (tmp_path / "run" / "runs.jsonl").read_text().splitlines()
    assert [json.loads(line)["from step"] for line in lines] == ["0", "1"]


@pytest.fixture
def second(
    weights: Path, data_folder: Path, trunk: State, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Options of a run that trains a second reader from a trunk, in the folder ``run``."""
    monkeypatch.setattr("training.commands.train_segmentation.trunk_state", lambda path: trunk)
    monkeypatch.setattr("training.commands.train_segmentation.Teacher", lambda state: SureOfRoad())
    given = ["--data", str(data_folder), "--trunk", "trunk.npz", "--weights", str(weights), "--second"]
    given += ["--out", str(tmp_path / "run"), "--height", "64", "--width", "96", "--views", "2", "--loaders", "0"]
    return given


def test_a_second_reader_begins_with_the_trunk_and_leaves_its_edges_alone(
    second: list[str], trunk: State, tmp_path: Path
) -> None:
    began = second_started(trunk, torch.randn(19, 97))

    main([*second, "--zoom", "1", "2", "--steps", "2"])

    trained = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["network"]
    changed = {name for name, tensor in began.state_dict().items() if not torch.equal(tensor, trained[name])}
    assert not any(name.startswith(("shallow.stride2", "shallow.stride4")) for name in changed)
    assert "shallow.stride8.0.convolutions.0.convolution.weight" in changed


def test_a_second_reader_goes_on_from_where_an_earlier_one_ended_with_pictures_of_other_shares(
    second: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = {name: torch.full_like(t, 0.01) for name, t in IndependentSegmentationNetwork().state_dict().items()}
    torch.save({"average": earlier}, tmp_path / "earlier.pt")
    mixes: list[Mix] = []

    def mix(**numbers: Any) -> Mix:
        mixes.append(Mix(**numbers))
        return mixes[-1]

    monkeypatch.setattr("training.commands.train_segmentation.Mix", mix)
    shares = ["--shares", "0.2", "0", "0.7", "0.1"]
    main([*second, *shares, "--earlier", str(tmp_path / "earlier.pt"), "--steps", "1"])

    went_on = torch.load(tmp_path / "run" / "checkpoint.pt", weights_only=True)["network"]
    assert all(torch.allclose(tensor, earlier[name], atol=1e-3) for name, tensor in went_on.items())
    [asked] = mixes
    assert asked.clear_shares == {"camvid": 0.2, "labelmefacade": 0.0, "nyuv2": 0.7, "ade_outdoor": 0.1}


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (["--shares", "0", "0", "0", "0"], "one of them above"),
        (["--shares", "1", "-1", "1", "1"], "at least 0"),
        (["--zoom", "2", "1"], "--zoom wants the least, above 0, and the greatest: not 2 1"),
        (["--zoom", "0", "1"], "not 0 1"),
    ],
)
def test_options_that_contradict_one_another_are_refused(
    options: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--data", "d", "--trunk", "t", "--weights", "w", "--out", str(tmp_path), "--steps", "1"]
    with pytest.raises(SystemExit):
        main([*given, *options])
    assert complaint in capsys.readouterr().err


def test_a_run_of_no_length_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--data", "d", "--trunk", "t.npz", "--weights", "w", "--out", str(tmp_path / "o")])
    assert "say how long" in capsys.readouterr().err
    assert not (tmp_path / "o").exists()
