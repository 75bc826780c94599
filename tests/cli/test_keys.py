"""`revisit keys`, and the key that a first start makes."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from app.cli import serve
from app.cli.__main__ import main
from app.cli.output import Failure
from schemas.settings import Settings
from tests.cli.fake_service import FakeService
from tests.keys_in_memory import KeyMaker

Out = pytest.CaptureFixture[str]


def keys(data: Path, *arguments: str) -> int:
    return main(["keys", *arguments, "--data", str(data)])


def listed(data: Path, capsys: Out) -> Any:
    capsys.readouterr()
    assert keys(data, "list", "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_a_key_is_printed_once_alone_and_listed_without_its_secret(tmp_path: Path, capsys: Out) -> None:
    options = ("--scope", "write", "--map", "campus", "--map", "depot", "--expires", "90d")
    assert keys(tmp_path, "create", "robot", *options, "--requests-per-minute", "60") == 0
    out = capsys.readouterr()
    assert re.fullmatch(r"rv_[0-9a-f]{12}_[0-9A-Za-z]{49}\n", out.out)
    assert f"campus, depot, kept in {tmp_path}. " in out.err
    secret = out.out.strip()[16:]

    assert keys(tmp_path, "list") == 0
    table = capsys.readouterr()
    assert "robot" in table.out
    assert out.out[:15] in table.out
    assert secret not in table.out + table.err
    (facts,) = listed(tmp_path, capsys)
    assert (facts["scope"], facts["maps"], facts["state"]) == ("write", ["campus", "depot"], "valid")
    assert (facts["per_minute"]["requests"], facts["last_used_at"]) == (60, None)


def test_machines_get_the_key_with_its_record(tmp_path: Path, capsys: Out) -> None:
    assert keys(tmp_path, "create", "robot", "--json") == 0
    made = json.loads(capsys.readouterr().out)
    assert made["key"].startswith(f"rv_{made['id']}_")
    assert made["scope"] == "read"


def test_revoking_and_clearing(tmp_path: Path, capsys: Out) -> None:
    keys(tmp_path, "create", "robot")
    assert keys(tmp_path, "revoke", "robot") == 0
    assert [one["state"] for one in listed(tmp_path, capsys)] == ["revoked"]
    assert keys(tmp_path, "revoke", "robot") == 1
    assert "keys list" in capsys.readouterr().err
    assert keys(tmp_path, "clear") == 2
    assert keys(tmp_path, "clear", "--yes") == 0
    assert listed(tmp_path, capsys) == []


@pytest.mark.parametrize("verb", [("list",), ("revoke", "robot"), ("clear", "--yes")])
def test_a_folder_that_is_none_of_a_service_is_told_and_not_made(
    tmp_path: Path, verb: Sequence[str], capsys: Out
) -> None:
    """A mistyped folder has no keys, which says nothing of the service that was meant."""
    folder = tmp_path / "dta"
    assert keys(folder, *verb) == 1
    said = capsys.readouterr()
    assert (said.out, folder.exists()) == ("", False)
    assert f"{folder} has no database of a service" in said.err


@pytest.mark.parametrize(
    "wrong",
    [
        ("robot!",),
        ("robot", "--map", "a/b"),
        ("robot", "--expires", "soon"),
        ("robot", "--expires", "9999999w"),
        ("robot", "--expires", "99999w"),
    ],
)
def test_what_cannot_be_used_is_wrong_use(tmp_path: Path, wrong: Sequence[str], capsys: Out) -> None:
    assert keys(tmp_path, "create", *wrong) == 2
    assert not (tmp_path / "revisit.db").exists() or listed(tmp_path, capsys) == []


def test_a_key_that_could_not_be_printed_is_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Out
) -> None:
    def fail(text: str) -> None:
        raise OSError("no room")

    with monkeypatch.context() as patch:
        patch.setattr("app.cli.keys.show", fail)
        with pytest.raises(OSError, match="no room"):
            keys(tmp_path, "create", "robot")
    assert listed(tmp_path, capsys) == []


def first(maker: KeyMaker, **settings: Any) -> None:
    serve.make_first_key(maker.service, Settings(**{"host": "0.0.0.0", "first_key": True, **settings}))


def test_a_first_start_makes_one_admin_key_and_prints_it_once(capsys: Out) -> None:
    maker = KeyMaker()
    first(maker)
    key = capsys.readouterr().out.split()[-1]
    first(maker)

    assert capsys.readouterr().out == ""
    (record,) = maker.store.all()
    assert (maker.service.read().access(key, record.created_at).scope, record.name) == ("admin", "first")


@pytest.mark.parametrize("settings", [{"open": True}, {"host": "127.0.0.1"}, {"first_key": False}])
def test_none_is_made_where_none_is_wanted(settings: dict[str, Any]) -> None:
    maker = KeyMaker()
    first(maker, **settings)
    assert maker.store.all() == []


def test_a_first_key_is_kept_before_it_is_printed_and_forgotten_if_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    maker = KeyMaker()
    kept: list[int] = []

    def fail(text: str) -> None:
        kept.append(len(maker.store.kept))
        raise OSError("the pipe is closed")

    monkeypatch.setattr(serve, "show", fail)
    with pytest.raises(OSError, match="closed"):
        first(maker)
    assert (kept, maker.store.all()) == ([1], [])


def test_with_a_key_other_addresses_are_allowed_and_without_they_are_not(tmp_path: Path) -> None:
    exposed = Settings(data=tmp_path, host="0.0.0.0")
    with pytest.raises(Failure, match="keys create"):
        serve._refuse_open(exposed)
    keys(tmp_path, "create", "operator", "--scope", "admin")
    serve._refuse_open(exposed)


def test_commands_send_the_key_of_the_variable_or_the_option(
    service: FakeService, monkeypatch: pytest.MonkeyPatch
) -> None:
    service.replies["GET /maps"] = 200, {"maps": []}
    monkeypatch.setenv("REVISIT_KEY", "rv_variable")
    assert main(["maps"]) == 0
    assert main(["maps", "--key", "rv_option"]) == 0
    assert service.keys == ["Bearer rv_variable", "Bearer rv_option"]
