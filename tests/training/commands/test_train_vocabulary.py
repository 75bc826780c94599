from pathlib import Path
from types import SimpleNamespace

import pytest

from training.commands.train_vocabulary import main


def test_a_vocabulary_is_written_into_a_folder_that_is_made_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    learned = SimpleNamespace(tensors=b"words", digest="0123")
    monkeypatch.setattr("training.commands.train_vocabulary.train_vocabulary", lambda *_: learned)

    main(["--encoder", "color", "--preset", "default", "--to", str(tmp_path / "seeds" / "1")])

    written = tmp_path / "seeds" / "1" / "color-default.vocabulary.safetensors"
    assert written.read_bytes() == b"words"
    assert f"{written.name}: 5 bytes, SHA-256 0123" in capsys.readouterr().out


def test_a_data_folder_is_wanted_where_the_encoder_needs_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["--encoder", "compact", "--to", str(tmp_path / "seeds")])
    assert "--encoder compact needs --data" in capsys.readouterr().err
    assert not (tmp_path / "seeds").exists()
