import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from schemas.picture import Picture
from training import data
from training.export import network_of, shared_digest
from training.export_fine import export_fine
from training.export_steady import export_steady
from training.fine_words import started_from as fine_words_from
from training.lexicon import ClipWords, Lexicon
from training.loop import Run
from training.mix import Mix
from training.steady_words import TRAINED, SteadyPlan, SteadyWords, main, started_from
from training.word_loss import word_loss_of
from worker.encoders.compact import CompactEncoder

MIX = Mix(strong=2, mild=0, clear=0, size=(64, 96))


def test_the_losses_sink_and_only_the_deep_layers_change(weights: Path, data_folder: Path, tmp_path: Path) -> None:
    network = started_from(weights)
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    found, clip = data.sources(data_folder, None), ClipWords(data_folder / data.CLIP_FILE)
    lexicon = Lexicon(clip, data.classes(data_folder))
    word_loss = word_loss_of(found, lexicon, torch.randn(len(lexicon.words), 97) / 10)
    plan = SteadyPlan(steps=15, trunk_rate=1e-3)
    run = Run(network, SteadyWords(network, word_loss, plan), plan, tmp_path)
    batch = data.Batches(found, lexicon, MIX, 5)[0]
    assert not any(name.startswith("clear") for name in batch)
    first, parts = run.objective(batch)

    run.train(iter([batch] * 15))

    last, parts_then = run.objective(batch)
    assert last.item() < first.item()
    assert parts_then["two_view"].item() < parts["two_view"].item()
    changed = {name for name, tensor in network.state_dict().items() if not torch.equal(before[name], tensor)}
    assert changed == {name for name in before if name.startswith(TRAINED)}


def test_the_command_trains_and_what_it_leaves_is_shipped_beside_the_same_detail_and_fine_words(
    weights: Path, data_folder: Path, tmp_path: Path
) -> None:
    fine = {"average": fine_words_from(network_of(weights)).state_dict(), "step": 3, "seconds": 60.0}
    torch.save(fine | {"plan": {"shared": shared_digest(load_file(weights))}}, tmp_path / "fine.pt")
    export_fine(tmp_path / "fine.pt", weights.parent)
    seen = Picture.of(np.random.default_rng(0).integers(0, 255, (96, 160, 3), np.uint8))
    before = CompactEncoder(weights=weights)
    given = ["--data", str(data_folder), "--weights", str(weights), "--out", str(tmp_path / "run")]
    given += ["--pairs", "2", "--loaders", "0", "--head-rate", "0.01"]

    main([*given, "--steps", "1"])
    main([*given, "--steps", "2", "--resume"])
    export_steady(tmp_path / "run" / "checkpoint.pt", weights.parent)

    after = CompactEncoder(weights=weights)
    (then,), (now,) = before.encode([seen]), after.encode([seen])
    assert not np.array_equal(then.semantic, now.semantic)
    assert np.array_equal(then.layers["detail"], now.layers["detail"])
    assert np.array_equal(before.fine(seen).semantic, after.fine(seen).semantic)
    facts = json.loads((weights.parent / "compact.json").read_text())
    assert facts["provenance"]["steadier words"]["training"]["steps"] == 2
    assert facts["provenance"]["training"]["steps"] == 1


def test_steadier_words_of_other_weights_are_refused(weights: Path, tmp_path: Path) -> None:
    state = started_from(weights).state_dict()
    torch.save({"average": state, "plan": {"shared": "0" * 64}}, tmp_path / "stranger.pt")

    with pytest.raises(ValueError, match="began with shallow layers of SHA-256 00000000"):
        export_steady(tmp_path / "stranger.pt", weights.parent)
