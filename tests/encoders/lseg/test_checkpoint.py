"""Weights files: good ones, their conversion, and everything that can be wrong with one."""

import argparse
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from schemas.errors import SetupError
from tests.encoders.lseg import small
from worker.encoders import inspection
from worker.encoders.lseg.checkpoint import check, convert, load

NORM = "scratch.refinenet1.resConfUnit1.bn1.weight"
HEAD = "scratch.head1.weight"

Change = Callable[[dict[str, Tensor]], object]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return small.save(small.state(), tmp_path / "lseg.ckpt")


def test_a_checkpoint_loads_under_its_own_names(file: Path) -> None:
    network, digest = load(file, small.SMALL)

    saved = small.state()
    for name, tensor in network.state_dict().items():
        assert torch.equal(tensor, saved[name])
    assert check(file, small.SMALL).digest == digest
    assert not any(parameter.requires_grad for parameter in network.parameters())


def test_the_trainings_arguments_may_lie_in_the_file(tmp_path: Path) -> None:
    further = {
        "hyper_parameters": argparse.Namespace(backbone="clip_vitl16_384"),
        "optimizer_states": [],
        "callbacks": {},
    }
    file = small.save(small.state(), tmp_path / "lseg.ckpt", **further)

    report = check(file, small.SMALL)

    assert report.usable
    assert "hyper_parameters" in report.notes[0]


class Surprise:
    """A class of ours in a pickle; loading must not make one."""


def test_other_pickled_objects_are_never_run(tmp_path: Path) -> None:
    file = small.save(small.state(), tmp_path / "lseg.ckpt", hyper_parameters=Surprise())

    with pytest.raises(SetupError, match="holds pickled objects other than tensors and plain values"):
        load(file, small.SMALL)


def test_half_precision_of_the_same_numbers_is_the_same_network(tmp_path: Path) -> None:
    """The published file keeps CLIP's matrices in float16; a float32 copy of them must not count as other weights."""
    whole = {n: t.half().float() if n.startswith("clip_pretrained") else t for n, t in small.state().items()}
    halves = {n: t.half() if n.startswith("clip_pretrained") else t for n, t in whole.items()}
    first, second = (small.save(s, tmp_path / f"{i}.ckpt") for i, s in enumerate((whole, halves)))

    assert load(first, small.SMALL)[1] == load(second, small.SMALL)[1]
    assert load(second, small.SMALL)[0].clip_pretrained.text_projection.dtype == torch.float32


def test_double_precision_of_the_same_numbers_is_the_same_network(tmp_path: Path, file: Path) -> None:
    doubles = {name: t.double() if t.is_floating_point() else t for name, t in small.state().items()}
    network, digest = load(small.save(doubles, tmp_path / "doubles.ckpt"), small.SMALL)
    assert digest == check(file, small.SMALL).digest
    assert {tensor.dtype for tensor in network.state_dict().values()} == {torch.float32}
    doubles[NORM] = doubles[NORM] * 1e300
    assert check(small.save(doubles, tmp_path / "beyond.ckpt"), small.SMALL).differences == (
        f"{NORM}: holds values that are not finite",
    )


def test_other_numbers_are_other_weights(tmp_path: Path, file: Path) -> None:
    changed = small.state()
    changed[HEAD][0, 0] += 1e-3

    assert load(small.save(changed, tmp_path / "other.ckpt"), small.SMALL)[1] != load(file, small.SMALL)[1]


def test_unused_tensors_may_be_left_out_or_differ(tmp_path: Path, file: Path) -> None:
    lean = {n: t for n, t in small.state().items() if "visual" not in n and "num_batches_tracked" not in n}
    lean["pretrained.model.norm.weight"] += 1

    assert load(small.save(lean, tmp_path / "lean.ckpt"), small.SMALL)[1] == load(file, small.SMALL)[1]


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda s: s.pop(NORM), f"{NORM}: missing, expected shape [8]"),
        (
            lambda s: s.update({"scratch.head_block.conv.weight": torch.ones(3)}),
            "head_block.conv.weight: surplus, of shape [3]",
        ),
        (lambda s: s.update({HEAD: torch.ones(16, 8)}), f"{HEAD}: shape [16, 8], expected [16, 8, 1, 1]"),
        (
            lambda s: s.update({NORM: torch.ones(8, dtype=torch.int64)}),
            f"{NORM}: torch.int64, expected a floating-point",
        ),
        (lambda s: s[HEAD].fill_(torch.nan), f"{HEAD}: holds values that are not finite"),
        (lambda s: s[HEAD].view(-1)[3:4].fill_(torch.inf), f"{HEAD}: holds values that are not finite"),
    ],
    ids=["missing", "surplus", "shape", "type", "nan", "infinite"],
)
def test_each_departure_is_named(tmp_path: Path, change: Change, named: str) -> None:
    tensors = small.state()
    change(tensors)
    file = small.save(tensors, tmp_path / "lseg.ckpt")

    report = check(file, small.SMALL)

    assert not report.usable
    assert report.digest is None
    assert len(report.differences) == 1
    assert named in report.differences[0]
    with pytest.raises(SetupError) as refused:
        load(file, small.SMALL)
    assert named in refused.value.detail
    with pytest.raises(SetupError):
        convert(file, tmp_path / "out.safetensors", small.SMALL)
    assert not (tmp_path / "out.safetensors").exists()


def test_an_error_names_some_and_check_names_all(tmp_path: Path) -> None:
    half = {name: tensor for name, tensor in small.state().items() if not name.startswith("scratch")}
    missing = {name for name in small.network(small.state()).state_dict() if name.startswith("scratch")}
    file = small.save(half, tmp_path / "half.ckpt")

    report = check(file, small.SMALL)

    assert report.kind == "lseg-checkpoint"
    assert {line.split(":")[0] for line in report.differences} == missing
    with pytest.raises(SetupError, match=r"; and \d+ more \(`./revisit weights check"):
        load(file, small.SMALL)


def test_another_networks_checkpoint_is_unknown(tmp_path: Path) -> None:
    file = small.save({"fc.weight": torch.ones(1)}, tmp_path / "foreign.ckpt")

    report = check(file, small.SMALL)

    assert (report.kind, report.usable) == ("unknown", False)
    assert "tensors is there; the file's 1 begin with: fc.weight" in report.differences[0]


def test_what_is_no_checkpoint_is_named_once(tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0 and so on")

    with pytest.raises(SetupError) as refused:
        convert(tmp_path / "photo.jpg", tmp_path / "out.safetensors", small.SMALL)

    assert refused.value.detail.count("photo.jpg") == 1


def test_no_damage_to_a_file_is_more_than_a_setup_error(tmp_path: Path, file: Path) -> None:
    """Whichever byte is wrong: where tensors are described, or within their values."""
    convert(file, tmp_path / "lseg.safetensors", small.SMALL)
    rng = np.random.default_rng(1)
    for path in (file, tmp_path / "lseg.safetensors"):
        data = path.read_bytes()
        for _ in range(40):
            damaged = bytearray(data)
            for at in (*rng.integers(0, len(data), 3), *rng.integers(0, 3000, 3), len(data) - rng.integers(1, 3000)):
                damaged[at] = rng.integers(0, 256)
            path.write_bytes(damaged)
            check(path, small.SMALL)  # says what it is, and raises nothing
        path.write_bytes(data)


def test_a_truncated_checkpoint_is_refused_with_its_size(file: Path) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])

    with pytest.raises(SetupError, match=rf"not a whole PyTorch file \({len(data) // 2} bytes\)"):
        load(file, small.SMALL)
    report = check(file, small.SMALL)
    assert report.kind == "unknown"
    assert "not a whole PyTorch file" in report.differences[0]


@pytest.mark.parametrize(
    "data", [b"", b"PK\x03\x04", b"\xff\xd8\xff\xe0 a photo", b"<html>not found</html>", b"\x80\x02}q\x00."]
)
def test_what_is_no_checkpoint_is_refused(tmp_path: Path, data: bytes) -> None:
    file = tmp_path / "lseg.ckpt"
    file.write_bytes(data)

    with pytest.raises(SetupError, match=f"weights {file}: (expected LSeg's demo_e200.ckpt|not a whole PyTorch file)"):
        load(file, small.SMALL)
    assert inspection.check(file).kind == "unknown"


@pytest.mark.parametrize(
    ("whole", "seen"),
    [
        ({"model": {}}, r"saw \['model'\]"),
        ([1, 2], "saw list"),
        ({"state_dict": {"net.a": 3, 7: 8}}, "no tensors: net.a, 7"),
    ],
)
def test_a_checkpoint_of_another_kind_is_refused(tmp_path: Path, whole: object, seen: str) -> None:
    torch.save(whole, tmp_path / "lseg.ckpt")

    with pytest.raises(SetupError, match=seen):
        load(tmp_path / "lseg.ckpt", small.SMALL)


def test_a_missing_file_is_a_setup_error(tmp_path: Path) -> None:
    for act in (lambda p: load(p, small.SMALL), check, inspection.check):
        with pytest.raises(SetupError, match="No such file"):
            act(tmp_path / "absent.ckpt")


def test_a_conversion_is_the_same_network_in_less_space(tmp_path: Path, file: Path) -> None:
    target = tmp_path / "lseg.safetensors"

    report = convert(file, target, small.SMALL)

    assert (report.kind, report.usable, report.path) == ("lseg-converted", True, target)
    assert report.digest == check(file, small.SMALL).digest
    assert f"source_sha256: {check(file, small.SMALL).sha256}" in report.notes
    assert target.stat().st_size < file.stat().st_size
    before, after = (load(path, small.SMALL)[0].state_dict() for path in (file, target))
    assert all(torch.equal(before[name], after[name]) for name in before)
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_a_conversion_keeps_half_precision(tmp_path: Path) -> None:
    halves = {n: t.half() if n.startswith("clip_pretrained") else t for n, t in small.state().items()}
    target = tmp_path / "lseg.safetensors"

    convert(small.save(halves, tmp_path / "lseg.ckpt"), target, small.SMALL)

    assert load_file(target)["clip_pretrained.text_projection"].dtype == torch.float16


def test_a_conversion_overwrites_nothing(tmp_path: Path, file: Path) -> None:
    target = tmp_path / "lseg.safetensors"
    target.write_text("mine")

    with pytest.raises(SetupError, match="exists"):
        convert(file, target, small.SMALL)
    assert target.read_text() == "mine"


def test_a_folder_that_is_not_there_cannot_be_written_to(tmp_path: Path, file: Path) -> None:
    with pytest.raises(SetupError, match="cannot write"):
        convert(file, tmp_path / "nowhere" / "lseg.safetensors", small.SMALL)


def test_a_truncated_conversion_is_refused(tmp_path: Path, file: Path) -> None:
    target = tmp_path / "lseg.safetensors"
    convert(file, target, small.SMALL)
    target.write_bytes(target.read_bytes()[:-100])

    with pytest.raises(SetupError, match="not a whole safetensors file"):
        load(target, small.SMALL)


def test_a_conversion_by_other_hands_is_taken(tmp_path: Path, file: Path) -> None:
    network = small.network(small.state())
    save_file(
        {name: tensor.contiguous() for name, tensor in network.state_dict().items()}, tmp_path / "own.safetensors"
    )

    assert check(tmp_path / "own.safetensors", small.SMALL).digest == check(file, small.SMALL).digest


def test_a_foreign_safetensors_file_is_unknown(tmp_path: Path) -> None:
    file = tmp_path / "foreign.safetensors"
    save_file({"a": torch.ones(2)}, file)

    report = inspection.check(file)

    assert (report.kind, report.usable) == ("unknown", False)
    assert report.differences


def test_check_leaves_the_file_alone(tmp_path: Path, file: Path) -> None:
    copy = shutil.copy(file, tmp_path / "copy.ckpt")

    check(file, small.SMALL)

    assert Path(copy).read_bytes() == file.read_bytes()
