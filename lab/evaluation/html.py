"""The report: one HTML file with everything in it, images included, that can be mailed and kept."""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lab.evaluation import plots
from lab.evaluation.measuring import Evaluation, alarms
from lab.libraries import for_studies

TEMPLATES = Path(__file__).parent


@dataclass(frozen=True)
class Shown:
    """An image of the report: PNG or JPEG bytes and what they show; a wide one holds two images side by side."""

    caption: str
    data: bytes
    wide: bool = False


@dataclass(frozen=True)
class Example:
    """A query with its answer, right or wrong.

    Parameters
    ----------
    title : str
        Which query, and what happened.
    right : bool or None
        None for images that are neither, such as the paper's figures.
    images : sequence of Shown
    """

    title: str
    right: bool | None
    images: Sequence[Shown]


def as_html(
    evaluations: Sequence[Evaluation], examples: Mapping[str, Sequence[Example]], title: str = "Evaluation"
) -> str:
    """The report, by the template ``report.html``.

    Parameters
    ----------
    evaluations : sequence of Evaluation
    examples : mapping of data set name to sequence of Example
    title : str

    Raises
    ------
    SetupError
        A library that draws it is not installed.
    """
    with for_studies():
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"data_url": _data_url, "share": _share}
    return environment.get_template("report.html").render(
        title=title,
        evaluations=evaluations,
        examples=examples,
        methods=list(dict.fromkeys(m.method for e in evaluations for m in e.methods)),
        alarms=alarms,
        plots=plots,
    )


def _data_url(image: bytes) -> str:
    """PNG, JPEG or SVG bytes as something that an ``img`` shows without fetching it."""
    kind = "png" if image.startswith(b"\x89PNG") else "svg+xml" if image.startswith(b"<?xml") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(image).decode()}"


def _share(value: float) -> str:
    """Three decimals, nothing for NaN."""
    return "" if math.isnan(value) else f"{value:.3f}"
