"""The compose files are what Compose itself takes. Nothing is started: `config` needs no engine."""

import shutil
import subprocess
from pathlib import Path

import pytest

DEPLOY = Path(__file__).parents[1] / "deploy"
OPTIONAL = "env_file:\n      - path: revisit.env # a copy of sample.env\n        required: false\n"
"""Compose 2.24 and newer: version 1, which Debian has, knows no file that may be missing."""


def config(folder: Path, *files: str) -> str:
    """What `docker-compose config` makes of the files of a folder; it validates them by the schema of Compose."""
    program = shutil.which("docker-compose")
    if program is None:
        pytest.skip("THE COMPOSE FILES ARE NOT VALIDATED: docker-compose is not installed")
    named = [word for file in files for word in ("-f", file)]
    done = subprocess.run(
        [program, "--env-file", "sample.env", *named, "config"],
        cwd=folder, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("files", [("compose.yaml",), ("compose.yaml", "encoder.yaml")])
def test_the_fleet(files: tuple[str, ...]) -> None:
    text = config(DEPLOY / "fleet", *files)
    assert "postgresql://revisit:changeme@database/revisit" in text
    assert ("REVISIT_ENCODER_URL: http://encoder:8000" in text) == (len(files) == 2)


def test_one_service(tmp_path: Path) -> None:
    written = (DEPLOY / "compose.yaml").read_text()
    assert written.count(OPTIONAL) == 1
    (tmp_path / "deploy").mkdir()
    for name in ("sample.env", "revisit.env"):
        shutil.copy(DEPLOY / "sample.env", tmp_path / "deploy" / name)
    (tmp_path / "deploy" / "compose.yaml").write_text(written.replace(OPTIONAL, "env_file: [revisit.env]\n"))
    assert "stop_grace_period: 30s" in config(tmp_path / "deploy", "compose.yaml")


def test_a_fault_is_found(tmp_path: Path) -> None:
    for name in ("sample.env", "nginx.conf"):
        shutil.copy(DEPLOY / "fleet" / name, tmp_path)
    text = (DEPLOY / "fleet" / "compose.yaml").read_text().replace("restart: unless-stopped", "restarts: sometimes")
    (tmp_path / "compose.yaml").write_text(text)
    with pytest.raises(AssertionError, match="restarts"):
        config(tmp_path, "compose.yaml")
