from pathlib import Path

import pytest
import torch

from training.commands.average import averaged, main


def test_an_average_lies_between_and_new_layers_stay() -> None:
    first, second = {"a": torch.tensor([0.0, 4.0])}, {"a": torch.tensor([1.0, 0.0]), "new": torch.tensor([7.0])}
    between = averaged(first, second, 0.25)
    assert between["a"].tolist() == [0.75, 1.0]
    assert between["new"].tolist() == [7.0]
    assert averaged(first, second, 0.0)["a"].tolist() == [1.0, 0.0]


def test_runs_of_different_networks_are_refused() -> None:
    with pytest.raises(ValueError, match="lacks old"):
        averaged({"old": torch.zeros(1)}, {"a": torch.zeros(1)}, 0.5)


def test_the_checkpoint_says_what_it_is_made_of(tmp_path: Path) -> None:
    for name, value, step in (("one", 0.0, 5), ("two", 1.0, 9)):
        average = {"a": torch.tensor([value])}
        torch.save({"average": average, "step": step, "seconds": 120.0}, tmp_path / f"{name}.pt")
    files = ["--checkpoints", str(tmp_path / "one.pt"), str(tmp_path / "two.pt"), "--to", str(tmp_path / "c.pt")]
    main([*files, "--weight", "0.4"])
    made = torch.load(tmp_path / "c.pt", weights_only=True)
    assert made["average"]["a"].item() == pytest.approx(0.6)
    assert made["step"] == 9
    assert made["averaged_with"] == {"share": 0.4, "steps": 5, "minutes": 2}
    with pytest.raises(SystemExit):
        main([*files, "--weight", "1.4"])
