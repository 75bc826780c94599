"""Calls that a page of the documentation shows, made as they stand there."""

import re
import subprocess
from pathlib import Path

ADDRESS = "localhost:8000"


def commands_of(page: str) -> list[str]:
    """The indented commands of a page, each with the lines that continue it."""
    lines = re.findall(r"^    (?:curl|printf) .*(?:\n    (?!curl|printf)\S*? .*)*", page, re.MULTILINE)
    return [re.sub(r"^    ", "", one, flags=re.MULTILINE).partition("\n{")[0] for one in lines]


def answers_of(page: Path, folder: Path, url: str) -> list[str]:
    """What the commands of a page print, run in a folder that has the files they name."""
    printed = []
    for command in commands_of(page.read_text()):
        assert "curl" not in command or ADDRESS in command, command
        ran = subprocess.run(
            ["bash", "-euc", command.replace(ADDRESS, url.removeprefix("http://")).replace("curl ", "curl -sS ", 1)],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ran.returncode == 0, f"{command}\n{ran.stderr}"
        printed.append(ran.stdout)
    return printed
