import json
from pathlib import Path

import torch

from tests.training.tokens import cache, write_teacher
from training.commands import cache_tokens, train_distilled
from worker.encoders.compact.encoder import WEIGHTS


def test_tokens_are_cached_once_and_a_head_learns_from_them(data_folder: Path, tmp_path: Path) -> None:
    tokens = cache(data_folder, tmp_path)
    made = {path: path.stat().st_mtime_ns for path in tokens.glob("*.npy")}
    out = tmp_path / "run"
    options = ["--data", str(data_folder), "--tokens", str(tokens), "--network", str(WEIGHTS), "--out", str(out)]

    cache(data_folder, tmp_path)
    train_distilled.main([*options, "--steps", "2", "--pairs", "2", "--workers", "0"])
    train_distilled.main([*options, "--steps", "3", "--pairs", "2", "--workers", "0", "--resume"])

    assert len(made) == 8
    assert {path: path.stat().st_mtime_ns for path in tokens.glob("*.npy")} == made
    saved = torch.load(out / "checkpoint.pt", weights_only=True)
    assert saved["step"] == 3
    assert [json.loads(line)["from step"] for line in (out / "runs.jsonl").read_text().splitlines()] == ["0", "2"]


def test_several_processes_share_the_images(data_folder: Path, tmp_path: Path) -> None:
    teacher = write_teacher(tmp_path / "teacher.onnx")
    for part, made in ((0, 4), (1, 8)):
        cache_tokens.main(
            [*("--teacher", str(teacher), "--data", str(data_folder), "--to", str(tmp_path / "tokens")),
             *("--part", str(part), "2")]
        )  # fmt: skip
        assert len(list((tmp_path / "tokens").glob("*.npy"))) == made
