"""``revisit enroll``: enrol images and folders with their attributes; a repeated command continues."""

import argparse
import queue
import threading
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from app.cli import images
from app.cli.options import Verbs, add_service_options, integer, json_object, number, service_of
from app.cli.output import DONE, FAILED, Failure, error_text, progress_bar, say, show, show_json, wrong_use

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import Enrolled


OF_THE_SERVICE = frozenset(("unauthorized", "forbidden", "other-site", "too-many-requests", "unavailable", "disk-full"))
"""Problems that every further image would meet too, once the client's patience is over."""

OF_GATEWAYS = (502, 504)
"""Statuses of a gateway that does not reach the service: so would every further image."""

Work: TypeAlias = "tuple[Path, images.Known]"
"""An image and its attributes."""


@dataclass
class Summary:
    """Results of all images."""

    enrolled: int = 0
    already_there: int = 0
    failed: list[dict[str, str]] = field(default_factory=list)
    skipped: list[dict[str, str]] = field(default_factory=list)
    warned: list[dict[str, str]] = field(default_factory=list)
    views: list[dict[str, Any]] = field(default_factory=list)

    @property
    def done(self) -> int:
        """Images that are in the map."""
        return self.enrolled + self.already_there

    def add(self, path: Path, answer: "Enrolled") -> None:
        """Note what became of an image that was taken."""
        view = answer.view
        failed = view.state == "failed"
        self.enrolled += answer.created and not failed
        self.already_there += not answer.created and not failed
        self.warned += [{"file": str(path), "reason": one.detail} for one in answer.warnings]
        self.views.append({"file": str(path), "id": view.id, "place": view.place, "created": answer.created})
        if failed:
            reason = "it could not be described" if view.failure is None else view.failure.detail
            self.failed.append({"file": str(path), "reason": reason})

    def sort(self, paths: Sequence[Path]) -> None:
        """Sort what is listed as the images are."""
        order = {str(path): i for i, path in enumerate(paths)}
        for listed in (self.warned, self.failed, self.views):
            listed.sort(key=lambda one: order[one["file"]])


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "enroll",
        help="enrol images or folders of images",
        description="Enrol images; those in the map already stay as they are. Repeat the command to continue.",
    )
    parser.add_argument(
        "paths", nargs="+", metavar="PATH", help="image, folder (all inside that is not hidden) or glob"
    )
    parser.add_argument("--map", help="map to enrol into (default: default)")
    parser.add_argument("--place", help="your name for the place that all these images show")
    parser.add_argument(
        "--place-from-folder", action="store_true", help="take the name of each image's folder as its place"
    )
    parser.add_argument(
        "--positions", type=Path, metavar="CSV", help="columns file and x,y[,z] or lat,lon[,alt]; heading, place"
    )
    parser.add_argument("--exif", action="store_true", help="take position, heading and time from the images' EXIF")
    for name, what in (("x", "metres"), ("y", "metres"), ("heading", "degrees clockwise from north, or from +y")):
        parser.add_argument(f"--{name}", type=number, metavar="N", help=f"{what}; of all these images")
    parser.add_argument("--metadata", metavar="JSON", help="kept with all these images")
    parser.add_argument(
        "--refuse-poor",
        action="store_true",
        help="refuse images that are dark, overexposed, covered or blurred, show mostly what moves, or are nearly in "
        "the map already",
    )
    parser.add_argument("--dry-run", action="store_true", help="only say what would be enrolled, and with what")
    parser.add_argument("--parallel", type=integer, default=4, metavar="N", help="images sent at once (default: 4)")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Enrol; returns 1 when some images were refused."""

    if not 1 <= arguments.parallel <= 64:
        wrong_use("--parallel takes 1 to 64")
    if arguments.place and arguments.place_from_folder:
        wrong_use("--place and --place-from-folder contradict each other")
    skipped: list[images.Skipped] = []
    work = _described(arguments, skipped)
    left_out = [{"file": str(one.path), "reason": one.reason} for one in skipped]
    if arguments.dry_run:
        return _show_dry_run(work, left_out, arguments)
    with service_of(arguments) as revisit:
        summary = _enrolled(revisit, work, arguments.parallel)
    summary.skipped = left_out
    if arguments.json:
        show_json(asdict(summary))
    else:
        more = f", {len(left_out)} skipped" if left_out else ""
        show(f"{summary.enrolled} enrolled, {summary.already_there} already there, {len(summary.failed)} failed{more}")
        for failure in summary.failed:
            say(f"  {failure['file']}: {failure['reason']}")
        for warned in summary.warned:
            say(f"  {warned['file']}: {warned['reason']}; enrolled all the same")
        _name_skipped(left_out)
    return FAILED if summary.failed else DONE


def _name_skipped(left_out: Sequence[dict[str, str]]) -> None:
    for one in left_out:
        say(f"  skipped {one['file']}: {one['reason']}")


def _show_dry_run(work: "Sequence[Work]", left_out: list[dict[str, str]], arguments: argparse.Namespace) -> int:
    """Say what would be enrolled; no service is called."""
    listed = [
        {"file": str(path), **{name: value for name, value in known.items() if value is not None}}
        for path, known in work
    ]
    if arguments.json:
        show_json({"would_enroll": listed, "skipped": left_out})
        return DONE
    for one in listed:
        show("  ".join([one["file"], *(f"{name}={value}" for name, value in one.items() if name != "file")]))
    show(f"{len(listed)} would be enrolled")
    _name_skipped(left_out)
    return DONE


def _described(arguments: argparse.Namespace, skipped: list[images.Skipped]) -> "list[Work]":
    """Each image with its attributes: the CSV wins over EXIF, both over the options for all images."""
    positions = None if arguments.positions is None else images.Positions(arguments.positions)
    work, unlisted = [], 0
    if (arguments.x is None) != (arguments.y is None):
        wrong_use("--x and --y are one position: give both")
    metadata = json_object("--metadata", arguments.metadata, '{"floor": 2}')
    of_all = _of_all(arguments, metadata)
    paths = images.find(arguments.paths, skipped)
    of_exif = _of_exif(paths) if arguments.exif else {}
    for path in paths:
        known = dict(of_all)
        if arguments.place_from_folder:
            known["place"] = images.absolute(path).parent.name
        listed = None if positions is None else positions.of(path)
        if arguments.exif:
            seen = of_exif[path]
            if "x" in (listed or {}) or ("x" in known and "lat" not in seen):  # beside metres north may lie anywhere
                seen.pop("heading", None)
            known = {name: value for name, value in known.items() if name not in ("x", "y") or "lat" not in seen} | seen
        if positions is not None:
            unlisted += listed is None
            if listed:
                frame = {"lat", "lon", "alt"} if "x" in listed else {"x", "y", "z"} if "lat" in listed else set()
                known = {name: value for name, value in known.items() if name not in frame} | listed
        work.append((path, known))
    if positions is not None:
        if unlisted:
            say(f"{unlisted} of {len(work)} images are not in {positions.path}; they are enrolled without position")
        if unused := positions.unused():
            say(f"{len(unused)} rows of {positions.path} name no image given here, such as {unused[0]}")
    return work


def _of_exif(paths: Sequence[Path]) -> dict[Path, images.Known]:
    """What the EXIF of each image says."""
    with images.exif_reader() as read_exif:
        return {path: read_exif(path) for path in paths}


def _of_all(arguments: argparse.Namespace, metadata: dict[str, Any] | None) -> images.Known:
    """The attributes that the options give to all images."""
    known: images.Known = {"map": arguments.map, "place": arguments.place}
    if arguments.refuse_poor:
        known["refuse_poor"] = True
    given = {"x": arguments.x, "y": arguments.y, "heading": arguments.heading, "metadata": metadata}
    return known | {name: value for name, value in given.items() if value is not None}


def _enrolled(revisit: "Revisit", work: Sequence[tuple[Path, images.Known]], parallel: int) -> Summary:
    """Send images, `parallel` at once, so that the service can batch them."""
    from revisit_client import RevisitProblem, Unsendable

    waiting: queue.SimpleQueue[tuple[Path, images.Known]] = queue.SimpleQueue()
    for item in work:
        waiting.put(item)
    summary, lock = Summary(), threading.Lock()
    stop: list[BaseException] = []

    def send(step: Callable[[str], None]) -> None:
        while not stop:
            try:
                path, known = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                answer = revisit.enroll(path, **known)
            except (RevisitProblem, Unsendable, OSError) as error:
                if isinstance(error, RevisitProblem) and (error.code in OF_THE_SERVICE or error.status in OF_GATEWAYS):
                    stop.append(error)
                    return
                with lock:
                    summary.failed.append({"file": str(path), "reason": _reason(error)})
                    step(path.name)
                continue
            except Exception as error:  # of ClientError, or none that was thought of: no image is left out in silence
                stop.append(error)
                return
            with lock:
                summary.add(path, answer)
                step(path.name)

    try:
        with progress_bar(len(work), "images") as step:
            threads = [
                threading.Thread(target=send, args=(step,), daemon=True) for _ in range(min(parallel, len(work)))
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    except KeyboardInterrupt as interrupt:
        stop.append(interrupt)
        say(_come_in(summary, work, ", and those that were being sent may be"))
        raise
    if stop:
        raise Failure(f"{error_text(stop[0])}\n{_come_in(summary, work)}")
    summary.sort([path for path, _ in work])
    return summary


def _come_in(summary: Summary, work: "Sequence[Work]", besides: str = "") -> str:
    return f"{summary.done} of {len(work)} images are enrolled{besides}; run the same command again to go on"


def _reason(error: Exception) -> str:
    if isinstance(error, OSError):
        return error.strerror or str(error)
    return str(error)
