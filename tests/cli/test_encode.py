"""What `encode` refuses before a network is loaded."""

import pytest

from app.cli.__main__ import main

Out = pytest.CaptureFixture[str]


def test_an_address_that_others_reach_needs_a_key_or_open(capsys: Out) -> None:
    assert main(["encode", "--host", "0.0.0.0"]) == 2
    said = capsys.readouterr().err
    assert "REVISIT_ENCODER_KEY" in said
    assert "--open" in said


@pytest.mark.parametrize("key", ["short", "sixteen chars with blanks", "sechzehn-zeichen-ä"])
def test_a_key_that_cannot_be_used_is_refused_and_not_shown(
    key: str, monkeypatch: pytest.MonkeyPatch, capsys: Out
) -> None:
    monkeypatch.setenv("REVISIT_ENCODER_KEY", key)

    assert main(["encode"]) == 2
    said = capsys.readouterr().err
    assert "16 visible" in said
    assert key not in said


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("REVISIT_ENCODER", "color", "compact or compact-open alone"),
        ("REVISIT_ENCODER_URL", "http://encoder:8100", "leave it out here"),
        ("REVISIT_ENCODER_URL", "encoder:8100", "no address such as"),
    ],
)
def test_settings_that_do_not_fit_an_encoder_are_refused(
    name: str, value: str, why: str, monkeypatch: pytest.MonkeyPatch, capsys: Out
) -> None:
    monkeypatch.setenv(name, value)

    assert main(["encode", "--port", "0"]) != 0
    assert why in capsys.readouterr().err
