"""What `./revisit weights check` says of the built-in encoder's files."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from worker.encoders.compact.encoder import weights_named
from worker.encoders.inspection import check


@pytest.mark.parametrize("name", ["compact", "compact-open"])
def test_the_weights_that_ship_are_recognised(name: str, tmp_path: Path) -> None:
    moved = tmp_path / "renamed.safetensors"
    moved.write_bytes(weights_named(name).read_bytes())

    for path in (weights_named(name), moved):
        report = check(path)

        assert (report.kind, report.usable) == ("compact", True)
        assert report.digest == report.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        assert report.notes == (f"135 tensors: the weights of revisit's own encoder, {name}",)


def test_weights_that_broke_off_are_not_usable(tmp_path: Path) -> None:
    cut = tmp_path / "compact.safetensors"
    cut.write_bytes(weights_named("compact").read_bytes()[:3_000_000])

    report = check(cut)

    assert (report.kind, report.usable, report.digest) == ("compact", False, None)
    assert "not a whole safetensors file" in report.differences[0]


def test_weights_that_were_changed_are_not_usable(tmp_path: Path) -> None:
    tensors = load_file(weights_named("compact"))
    tensors["words.weight"] = np.full_like(tensors["words.weight"], np.nan)
    changed = tmp_path / "compact.safetensors"
    save_file(tensors, changed)

    report = check(changed)

    assert not report.usable
    assert "none of the weights that ship" in report.differences[0]


def test_weights_of_ones_own_are_what_their_json_file_describes(tmp_path: Path) -> None:
    own = tmp_path / "own.safetensors"
    save_file({"words.weight": np.ones(2), "detail.weight": np.ones(2)}, own)
    assert not check(own).usable
    described = {"file": own.name, "sha256": hashlib.sha256(own.read_bytes()).hexdigest()}
    own.with_suffix(".json").write_text(json.dumps({"weights": described}))

    assert check(own).usable
    assert "own encoder, own" in check(own).notes[0]
