"""Commands whose arguments are their modules' own."""

import pytest

from app.cli.__main__ import main
from app.cli.study import over_http
from lab import evaluate
from lab.benchmarks import __main__ as benchmarks
from lab.evaluation.remote import connect


def test_everything_after_the_command_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[object] = []

    def stand_in(*arguments: object) -> int:
        given.append(arguments)
        return len(given) - 1

    monkeypatch.setattr(benchmarks, "main", stand_in)
    monkeypatch.setattr(evaluate, "main", stand_in)

    assert main(["benchmark", "stages", "--help"]) == 0
    assert main(["evaluate", "pairs", "--root", "x"]) == 1
    assert given == [(["stages", "--help"], over_http), (["pairs", "--root", "x"], connect)]


def test_other_commands_refuse_what_they_do_not_know(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["maps", "--unheard-of"])

    assert caught.value.code == 2
    assert "--unheard-of" in capsys.readouterr().err
