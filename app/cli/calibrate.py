"""``revisit calibrate``: fit a map's confidences to labelled images of one's own site."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.loops import OF_ONE_IMAGE
from app.cli.options import Verbs, add_service_options, number, service_of
from app.cli.output import DONE, Failure, progress_bar, say, show, show_json, table, wrong_use
from schemas.values import composed

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import CalibrationReport, HeldOutFigures, MeasuredRate, QueryAnswer

    from schemas.records import ViewAttributes
    from worker.service import manifests

FRAMES = (("x", "y"), ("lat", "lon"))
MOST = 5000


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "calibrate",
        help="fit a map's confidences to labelled images of your own site",
        description="Query a map with labelled images, fit its confidences to what was right, and judge that on "
        "held-out images. It is kept if it does not do worse than the shipped calibration there.",
    )
    parser.add_argument(
        "labels",
        type=Path,
        nargs="?",
        metavar="CSV",
        help="a table as imports take them; columns: file (relative to the table), and place (empty: none of the map's "
        "places), or x and y, or lat and lon; optionally block, such as a drive. Rows in the order of capture",
    )
    parser.add_argument("--map", default="default", help="which map (default: default)")
    parser.add_argument(
        "--within", type=number, default=0.0, metavar="METRES",
        help="a first place this near a labelled position is right (at least the map's same_place_m)",
    )  # fmt: skip
    parser.add_argument("--dry-run", action="store_true", help="report, and keep nothing")
    parser.add_argument("--forget", action="store_true", help="return to the shipped calibration")
    add_service_options(parser)
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class Row:
    """A labelled image: the right place's name, or its position, or neither (none of the map's places)."""

    image: Path
    place: str | None
    position: tuple[float, float] | None
    geographic: bool
    block: str | None


def run(arguments: argparse.Namespace) -> int:
    """Calibrate; returns 0 also when nothing was kept. Images that the service refuses are left out, and told."""
    from revisit_client import RevisitProblem

    if (arguments.labels is None) != arguments.forget:
        wrong_use("give either a CSV file of labelled images or --forget")
    if arguments.forget:
        with service_of(arguments) as revisit:
            decision = revisit.forget_calibration(arguments.map).decision
        if arguments.json:
            show_json(decision)
        else:
            show(f"the map {arguments.map} decides by the shipped calibration")
        return DONE
    rows = read(arguments.labels)
    with service_of(arguments) as revisit:
        within = max(arguments.within, float(revisit.map(arguments.map).ranking["same_place_m"]))
        _refuse_unknown_places(revisit, arguments.map, rows)
        observed, used, left_out = [], dict[str, Any](), []
        with progress_bar(len(rows), "images queried", quiet=arguments.json) as step:
            for row in rows:
                try:
                    answer = revisit.query(row.image, map=arguments.map)
                except RevisitProblem as problem:
                    if problem.code not in OF_ONE_IMAGE:
                        raise
                    left_out.append(f"left out {row.image}: {problem}")
                else:
                    used = {"recipe": answer.recipe, "ranking": answer.ranking}
                    observed.append(_observed(revisit, arguments.map, row, answer, within))
                step(row.image.name)
        for line in left_out:
            say(line)
        if not observed:
            raise Failure("the service took none of the labelled images")
        report = revisit.calibrate(arguments.map, observed=observed, dry_run=arguments.dry_run, **used)
    if arguments.json:
        show_json(report)
    else:
        show(report_text(report))
    return DONE


def read(path: Path) -> list[Row]:
    """The labelled images of a table, read as manifests are; raises Failure when it cannot be used."""
    from worker.service import manifests

    try:
        manifest = manifests.read_manifest(str(path), path.read_bytes())
        given = [manifests.attributes(row, str(path)) for row in manifest.rows]
    except ValueError as error:
        wrong_use(str(error))
    labels = [names for names in (("place",), *FRAMES) if set(names).issubset(manifest.columns)]
    if len(labels) != 1 or not {*manifests.NAMES, "block"}.issuperset(manifest.columns):
        wrong_use(f"{path}: the first line needs to name file, and place or x,y or lat,lon, and block if you like")
    if not 0 < len(given) <= MOST:
        wrong_use(f"{path}: has {len(given)} rows; 1 to {MOST} are taken")
    return [_row(path, row, known, labels[0]) for row, known in zip(manifest.rows, given, strict=True)]


def _row(path: Path, row: "manifests.Row", known: "ViewAttributes", label: tuple[str, ...]) -> Row:
    image = path.parent / row.file
    if not image.is_file():
        wrong_use(f"{path}, line {row.line}: there is no file {image}")
    position = None
    if label in FRAMES:
        first, second = (getattr(known.position, name) for name in label)
        if first is None:
            wrong_use(f"{path}, line {row.line}: has no {' and '.join(label)}")
        position = first, second
    block = row.further.get("block")
    return Row(image, known.place, position, "lat" in label, None if block is None else str(block))


def _refuse_unknown_places(revisit: "Revisit", map_name: str, rows: list[Row]) -> None:
    named = {row.place for row in rows if row.place is not None}
    if named and (unknown := sorted(named - {composed(place.place) for place in revisit.places(map_name)})):
        first = ", ".join(map(repr, unknown[:5]))
        wrong_use(f"no view of the map {map_name} shows {first}; leave place empty where none of its places is right")


def _observed(revisit: "Revisit", map_name: str, row: Row, answer: "QueryAnswer", within: float) -> dict[str, Any]:
    """The answer and whether its first place is right, for `Revisit.calibrate`."""
    first = answer.places[0] if answer.places else None
    known = row.place is not None
    right = first is not None and known and first.place is not None and composed(first.place) == row.place
    if row.position is not None:
        right = first is not None and first.position is not None and _metres(row, first.position) <= within
        around = (*row.position, max(within, 0.01))
        known = right or any(revisit.views(map_name, near=around, geographic=row.geographic, limit=1))
    return {"features": dict(answer.decision.features), "right": right, "known": known or right, "block": row.block}


def _metres(row: Row, position: Any) -> float:
    """From the labelled position to another, over the ground; infinite in the other frame."""
    from schemas.records import Position
    from worker.method.positions import distance

    assert row.position is not None
    first, second = row.position
    label = Position(lat=first, lon=second) if row.geographic else Position(x=first, y=second)
    return distance(label, Position(x=position.x, y=position.y, lat=position.lat, lon=position.lon))


def report_text(report: "CalibrationReport") -> str:
    """The report as text."""
    figures: tuple[tuple[str, Callable[[HeldOutFigures], MeasuredRate]], ...] = (
        ("right among matched", lambda f: f.precision),
        ("matched among right", lambda f: f.matched_share),
        ("false accepts per 1,000 unknown", lambda f: f.false_accepts_per_1000),
    )
    rows = [(name, _rate(of(report.shipped)), _rate(of(report.own))) for name, of in figures]
    rows += [
        ("calibration error", f"{report.shipped.expected_error:.3f}", f"{report.own.expected_error:.3f}"),
        ("log loss", f"{report.shipped.log_loss:.3f}", f"{report.own.log_loss:.3f}"),
    ]
    return "\n".join(
        [
            f"{report.queries} labelled images: {report.right} first places right, {report.unknown} of unknown places"
            + (f"; {report.unanswered} without an answer left out" if report.unanswered else ""),
            table((f"held out, at precision {report.precision:g}", "shipped", "own"), rows),
            report.detail,
        ]
    )


def _rate(rate: "MeasuredRate") -> str:
    if rate.value is None:
        return "-"
    digits = 0 if rate.interval[1] > 1 else 3
    low, up = (f"{bound:.{digits}f}" for bound in rate.interval)
    return f"{rate.value:.{digits}f} ({low} to {up}; {rate.count} of {rate.of})"
