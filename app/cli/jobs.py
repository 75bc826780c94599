"""``revisit jobs``: work in the background, listed, followed and cancelled."""

import argparse
from itertools import islice
from typing import TYPE_CHECKING, Any

from app.cli.options import Verbs, add_service_options, integer, service_of
from app.cli.output import DONE, job_progress, say, show, show_json, table, wrong_use

if TYPE_CHECKING:
    from revisit_client.wire import Job

KINDS = ("describe", "recipe", "shadow", "vocabulary", "snapshot", "import")

STATES = ("waiting", "running", "done", "failed", "cancelled")


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "jobs",
        help="work in the background: list it, follow or cancel a job",
        description="Jobs of the service, newest first: imports, recipes, vocabularies, snapshots, views to describe.",
    )
    parser.add_argument("id", nargs="?", help="show this job, with its result")
    parser.add_argument("--map", help="jobs of this map")
    parser.add_argument("--kind", choices=KINDS, help="jobs of this kind")
    parser.add_argument("--state", choices=STATES, help="jobs in this state")
    parser.add_argument("--limit", type=integer, default=50, metavar="N", help="at most so many (default: 50)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--follow", action="store_true", help="show the progress of the named job until it has ended")
    what.add_argument("--cancel", action="store_true", help="cancel the named job")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """List jobs, or show, follow or cancel one."""

    filters = {name: getattr(arguments, name) for name in ("map", "kind", "state")}
    if arguments.id is None and (arguments.follow or arguments.cancel):
        wrong_use("--follow and --cancel need the id of a job")
    if arguments.id is not None and any(filters.values()):
        wrong_use("--map, --kind and --state are for lists; give them or the id of a job")
    if arguments.limit < 1:
        wrong_use("--limit is at least 1")
    with service_of(arguments) as revisit:
        if arguments.id is None:
            jobs = list(islice(revisit.jobs(**filters), arguments.limit))
            _list(jobs, arguments)
            return DONE
        if arguments.cancel:
            job = revisit.cancel_job(arguments.id)
        elif arguments.follow:
            job = revisit.job(arguments.id)
            with job_progress(f"{job.kind} of map {job.map}", quiet=arguments.json) as follow:
                job = revisit.wait_for_job(job.id, timeout=float("inf"), follow=follow)
        else:
            job = revisit.job(arguments.id)
    # A job has too many fields for a table.
    show_json(job)
    return DONE


def _list(jobs: "list[Job]", arguments: argparse.Namespace) -> None:
    if arguments.json:
        show_json(jobs)
        return
    heads = ("job", "kind", "map", "state", "progress", "created", "finished")
    show(table(heads, [_row(job) for job in jobs]))
    if len(jobs) == arguments.limit:
        say(f"the first {arguments.limit}; --limit shows more")


def _row(job: "Job") -> tuple[Any, ...]:
    state = job.state if job.failure is None else f"{job.state}: {job.failure.code}"
    progress = None if job.progress is None else f"{job.progress.done} of {job.progress.total}"
    finished = None if job.finished_at is None else f"{job.finished_at:%Y-%m-%d %H:%M:%S}"
    return job.id, job.kind, job.map, state, progress, f"{job.created_at:%Y-%m-%d %H:%M:%S}", finished
