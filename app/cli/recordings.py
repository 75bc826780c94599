"""``revisit import``: send a recording (an archive, or a folder of images), and follow its import."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.options import Verbs, add_service_options
from app.cli.output import DONE, FAILED, job_progress, say, show, show_json, wrong_use

if TYPE_CHECKING:
    from revisit_client.wire import Job

MOST_SHOWN = 20
"""Errors printed; --json has all."""


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "import",
        help="import a recording: a zip archive or a folder of images, with a manifest, or a video",
        description="Send a zip archive or a folder of images, a video (MP4, MOV, MKV, WebM, AVI), or a recording "
        "of ROS 2 (MCAP, with its images' topic and one of poses). "
        "A manifest (manifest.csv or manifest.ndjson inside) has the columns file, place, x, y, z, lat, lon, alt, "
        "heading, captured_at; any other is kept as metadata. Images "
        "that are in the map already are skipped: repeat the command to continue.",
    )
    parser.add_argument(
        "source", type=Path, metavar="FILE|DIR", help="zip archive, video, MCAP file, or folder (with all inside)"
    )
    parser.add_argument("--map", default="default", help="map to import into (default: default)")
    parser.add_argument("--manifest", type=Path, metavar="FILE", help="manifest of a folder that holds none")
    parser.add_argument("--exif", action="store_true", help="take place and time from EXIF where no manifest has them")
    parser.add_argument("--panorama", action="store_true", help="each image is a panorama, and becomes eight views")
    parser.add_argument(
        "--every",
        metavar="STEP",
        help="least time (2s, 1min) or way (1m: metres) from one image to the next; else all, of a video one a second",
    )
    parser.add_argument("--image-topic", metavar="TOPIC", help="topic of the images, of a ROS 2 recording with several")
    parser.add_argument("--pose-topic", metavar="TOPIC", help="topic of the poses, of a ROS 2 recording with several")
    parser.add_argument(
        "--refuse-poor",
        action="store_true",
        help="leave out images that are dark, overexposed, covered or blurred, show mostly what moves, or are nearly "
        "in the map already",
    )
    parser.add_argument("--no-wait", action="store_true", help="return once everything is sent")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Import; returns 1 when some images were refused."""
    from revisit_client import Revisit

    with Revisit(arguments.url, key=arguments.key, timeout=600) as revisit:
        try:
            job = revisit.import_recording(
                arguments.source,
                map=arguments.map,
                manifest=arguments.manifest,
                exif=arguments.exif,
                panorama=arguments.panorama,
                refuse_poor=arguments.refuse_poor or None,
                every=arguments.every,
                image_topic=arguments.image_topic,
                pose_topic=arguments.pose_topic,
            )
        except ValueError as error:
            wrong_use(str(error))
        if not arguments.no_wait:
            say(f"job {job.id} is running; interrupting this command does not stop it")
            with job_progress("images", quiet=arguments.json) as follow:
                job = revisit.wait_for_job(job.id, timeout=float("inf"), follow=follow)
    if arguments.json:
        show_json(job)
    elif job.result is None:
        show(f"job {job.id} of map {job.map}: {job.state}")
    else:
        _show(job)
    return FAILED if job.result is not None and job.result.get("failed") else DONE


def _show(job: "Job") -> None:
    report = job.result or {}
    show(f"{report['enrolled']} enrolled, {report['already_there']} already there, {report['failed']} failed")
    if report.get("left_out"):
        say(f"{report['left_out']} left out, by --every or as depth images")
    if report.get("poor"):
        say(f"{report['poor']} of them are dark, overexposed, covered or blurred")
    for error in report["errors"][:MOST_SHOWN]:
        say(f"  {error['file']}: {error['detail']}")
    left = len(report["errors"]) - MOST_SHOWN + report["errors_left_off"]
    if left > 0:
        say(f"  and {left} more; GET /jobs/{job.id} lists them")
