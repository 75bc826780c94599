"""Settings that cannot be meant are refused before anything is made or listened to."""

import re
from pathlib import Path

import pytest

from schemas.errors import SetupError
from schemas.settings import Settings, read_settings
from worker.storage.store import open_store

NUMBERS = sorted(name for name, field in Settings.model_fields.items() if field.annotation is float)


@pytest.mark.parametrize("text", ["", " "])
def test_a_data_folder_without_a_name_is_not_the_one_that_one_stands_in(text: str) -> None:
    """`REVISIT_DATA=$UNSET ./revisit serve` would fill the present folder."""
    with pytest.raises(SetupError, match=re.escape(f"REVISIT_DATA={text!r}: is empty; name a folder")):
        read_settings({"REVISIT_DATA": text})
    assert str(read_settings({"REVISIT_DATA": "."}).data) == "."


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_without_end_are_refused_in_words(name: str) -> None:
    """1e300 megabytes are no number of bytes: the service ended with a traceback."""
    for text in ("inf", "1e300", "nan", "-inf"):
        with pytest.raises(SetupError, match=f"^REVISIT_{name.upper()}='{text}': (is too large|Input should be)"):
            read_settings({f"REVISIT_{name.upper()}": text})
    assert getattr(read_settings({f"REVISIT_{name.upper()}": "1e9"}), name) == 1e9


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mqtt", "mqtt://robot:hunter2@broker.example"),
        ("webhook", "https://app:hunter2@app.example/hooks"),
        ("webhook", "https://app:hun/ter@2@app.example/hooks"),
        ("encoder_url", "HTTP://node:hunter2@encoder:8100"),
        ("images", "node:hunter2@bucket"),
    ],
)
def test_a_password_in_an_address_that_is_refused_is_not_shown(name: str, value: str) -> None:
    """What stops a container is in its log."""
    with pytest.raises(SetupError) as refused:
        read_settings({f"REVISIT_{name.upper()}": value})
    assert "***@" in str(refused.value)
    assert not [part for part in ("hun", "ter") if part in str(refused.value)]


@pytest.mark.parametrize(
    "url", ["postgresql//revisit:hunter2@db/revisit", "postgresql://revisit:hunter2@db:port/revisit"]
)
def test_nor_is_that_of_a_database_whose_address_cannot_be_read(url: str, tmp_path: Path) -> None:
    with pytest.raises(SetupError, match=r"REVISIT_DATABASE: '.*\*\*\*@db.*' is not a database URL") as refused:
        open_store(url, tmp_path)
    assert "hunter2" not in str(refused.value)


def test_the_numbers_are_known() -> None:
    assert {"body_s", "max_body_mb", "wait"} <= set(NUMBERS)
