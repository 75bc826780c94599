"""Settings that cannot be meant are refused before anything is made or listened to."""

import re

import pytest

from schemas.errors import SetupError
from schemas.settings import Settings, read_settings

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


def test_the_numbers_are_known() -> None:
    assert {"body_s", "max_body_mb", "wait"} <= set(NUMBERS)
