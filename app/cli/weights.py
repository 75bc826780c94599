"""``revisit weights check | convert``: check weights files, convert published checkpoints to safetensors."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.options import Verbs
from app.cli.output import DONE, FAILED, show, show_json, size

if TYPE_CHECKING:
    from worker.encoders.lseg.checkpoint import WeightsReport


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    weights = verbs.add_parser("weights", help="check or convert a weights file")
    commands = weights.add_subparsers(title="commands", metavar="COMMAND", required=True)
    check = commands.add_parser("check", help="show what a weights file holds; exit code 1 when it cannot be used")
    check.add_argument("file", type=Path, help="a checkpoint or its conversion")
    check.add_argument("--json", action="store_true", help="answer as JSON, for machines")
    check.set_defaults(run=run_check)
    convert = commands.add_parser("convert", help="make a safetensors file of a published checkpoint")
    convert.add_argument("source", type=Path, help="the checkpoint")
    convert.add_argument("target", type=Path, help="file to write, .safetensors")
    convert.add_argument("--json", action="store_true", help="answer as JSON, for machines")
    convert.set_defaults(run=run_convert)


def run_check(arguments: argparse.Namespace) -> int:
    """Check a weights file; returns 1 when it cannot be used."""
    from worker.encoders import inspection

    return _show(inspection.check(arguments.file), arguments.json)


def run_convert(arguments: argparse.Namespace) -> int:
    """Convert a checkpoint to safetensors; returns 1 when it cannot be used."""
    from worker.encoders.lseg import checkpoint

    return _show(checkpoint.convert(arguments.source, arguments.target), arguments.json)


def _show(report: "WeightsReport", as_json: bool) -> int:
    if as_json:
        show_json(asdict(report))
    else:
        show(f"{report.path}: {report.kind}, {size(report.byte_count)}")
        show(f"  file    {report.sha256}")
        show(f"  tensors {report.digest or '-'}")
        for line in (*report.notes, *report.differences):
            show(f"  {line}")
    return DONE if report.usable else FAILED
