"""``python -m lab.faults.flips``: damage a data folder at random, again and again, and see what finds and mends it.

Each trial copies a data folder, flips a byte or cuts a file off at random, and asks three things. Does `doctor` find
it; or else, is every row and every image provably as it was? Does a service started on it answer without a failure of
its own and without anything wrong? Does `doctor --repair` mend it, or say what cannot be mended?
"""

import argparse
import hashlib
import json
import logging
import random
import shutil
import sqlite3
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from lab.faults.data_folder import Known, content, files, make, settings_of
from schemas.errors import RevisitError, SetupError
from schemas.records import Filters
from worker.runtime import Runtime, build
from worker.storage.examining import examine
from worker.storage.repairing import repair

KINDS = ("database", "log", "image")
SETTLED = 0.5
"""Share of the trials on a folder of a service that was stopped: without a log, which hides pages of the database."""

CUT = 0.3
"""Share of the trials that cut a file off instead of flipping a byte."""


@dataclass
class Trial:
    """What one damage did.

    Parameters
    ----------
    number : int
    where : str
        Kind of file, and what was done at which byte.
    found : int
        Findings of `doctor`; 0 when it is silent.
    unchanged : bool
        Whether all rows and images are as they were.
    answers : str
        ``answered``, or ``refused to start`` in words; a failure otherwise.
    wrong : list of str
        Failures and wrong answers of the service; must be empty.
    repaired : str
        ``nothing to do``, ``mended``, ``said what is left``, ``nothing said``, or a failure.
    examples : list of str
        Some findings.
    left : list of str
        Some findings after the repair.
    """

    number: int
    where: str
    found: int = 0
    unchanged: bool = False
    answers: str = ""
    wrong: list[str] = field(default_factory=list)
    repaired: str = ""
    examples: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)

    @property
    def kind(self) -> str:
        """Kind of file and of damage."""
        return " ".join(self.where.split()[:2])

    @property
    def missed(self) -> bool:
        """Whether content changed, and nothing said so."""
        return not self.found and not self.unchanged


class Flips:
    """Trials on copies of one data folder.

    Parameters
    ----------
    folder : Path
        Scratch folder.
    seed : int
        Trial n of a seed is always the same damage.
    """

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder, self._seed = folder, seed
        self._base = folder / "base"
        self._views: dict[str, Known] = make(self._base, folder / "made")
        self._settled = folder / "settled"
        shutil.copytree(self._base, self._settled)
        with closing(sqlite3.connect(self._settled / "revisit.db")) as connection:
            connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        self._content = content(self._base)
        if content(self._settled) != self._content:
            raise AssertionError("the two folders must hold the same")

    def run(self, number: int) -> Trial:
        """Run one trial."""
        draw = random.Random(f"{self._seed} {number}")
        data = self._folder / "trial"
        shutil.rmtree(data, ignore_errors=True)
        settled = draw.random() < SETTLED
        shutil.copytree(self._settled if settled else self._base, data)
        trial = Trial(number, _damage(data, draw))
        try:
            trial.unchanged = content(data) == self._content
        except Exception:  # whatever SQLite says of a damaged file
            trial.unchanged = False
        url = settings_of(data).database_url
        served = self._folder / "served"
        shutil.rmtree(served, ignore_errors=True)
        shutil.copytree(data, served)
        try:
            found = list(examine(url, data))
            trial.found, trial.examples = len(found), [str(finding)[:200] for finding in found[:3]]
        except Exception as error:
            trial.wrong.append(f"doctor failed: {error!r}")
        self._ask(served, trial)
        try:
            done, left = repair(url, data)
            again = list(examine(url, data))
            trial.left = [str(finding)[:200] for finding in again[:3]]
            trial.repaired = (
                "said what is left"
                if again
                else "mended"
                if done
                else "nothing said"
                if trial.found
                else "nothing to do"
            )
            if [str(one) for one in again] != [str(one) for one in left]:
                trial.wrong.append("doctor says something else after the repair than the repair")
        except Exception as error:
            trial.repaired = f"failed: {error!r}"
            trial.wrong.append(f"repair failed: {error!r}")
        return trial

    def _ask(self, data: Path, trial: Trial) -> None:
        """Start a service on the damaged folder, look at everything and query."""
        records = _Tracebacks()
        logging.getLogger("revisit").addHandler(records)
        try:
            try:
                runtime = build(settings_of(data))
            except SetupError:
                trial.answers = "refused to start"
                return
            try:
                runtime.start()
                trial.answers = "answered"
                self._look(runtime, trial.wrong)
            except RevisitError as error:
                trial.answers = f"refused: {error.code}"
            finally:
                runtime.stop()
        except Exception as error:
            trial.wrong.append(f"the service failed: {error!r}")
        finally:
            logging.getLogger("revisit").removeHandler(records)
        trial.wrong += records.seen[:3]

    def _look(self, runtime: Runtime, wrong: list[str]) -> None:
        services = runtime.services
        for view_id, known in self._views.items():
            try:
                record = services.views.get(view_id).record
                if record.failure is None and record.attributes.place != known.place:
                    wrong.append(f"view {view_id} is said to show {record.attributes.place!r}, not {known.place!r}")
                image, _ = services.renderings.image(view_id)
                if hashlib.sha256(image).hexdigest() != known.sha256:
                    wrong.append(f"view {view_id} has a wrong image")
            except RevisitError:
                pass  # said in words
        for call in (
            services.maps.all,
            lambda: services.views.page(None, Filters(), state=None, newest_first=False, cursor=None, limit=50),
            lambda: services.jobs.page(None, kinds=(), state=None, cursor=None, limit=50),
        ):
            with suppress(RevisitError):
                call()
        for known in list(self._views.values())[::3]:
            try:
                for scored in services.query.query(known.image, known.map).results.views:
                    right = self._views.get(scored.view.id)
                    if right is None or scored.view.attributes.place != right.place or scored.view.map != right.map:
                        wrong.append(f"the query of {known.place!r} is answered with {scored.view.attributes.place!r}")
            except RevisitError:
                pass


class _Tracebacks(logging.Handler):
    """Notes every traceback that is logged for something else than foreseen damage."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info and record.exc_info[1] is not None and not isinstance(record.exc_info[1], RevisitError):
            self.seen.append(f"a traceback in the log: {record.getMessage()}: {record.exc_info[1]!r}"[:300])


def _damage(data: Path, draw: random.Random) -> str:
    """Damage one file; returns what was done."""
    there = {path.name for path in files(data)}
    kind = draw.choice([kind for kind in KINDS if kind != "log" or "revisit.db-wal" in there])
    ends = {"database": "revisit.db", "log": "revisit.db-wal"}
    path = draw.choice([p for p in files(data) if ends.get(kind, p.name) == p.name and (kind in ends) != _is_image(p)])
    body = bytearray(path.read_bytes())
    at = draw.randrange(len(body))
    if draw.random() < CUT:
        path.write_bytes(body[:at])
        return f"{kind} cut at {at} of {len(body)}"
    body[at] ^= draw.randrange(1, 256)
    path.write_bytes(body)
    return f"{kind} flipped at {at} of {len(body)}"


def _is_image(path: Path) -> bool:
    return "pictures" in path.parts


def table(trials: Sequence[Trial]) -> str:
    """What the trials came to, by kind of damage."""
    heads = ("damage", "trials", "found", "unchanged", "missed", "wrong", "mended", "left, said", "clean")
    lines = [("{:18}" + " {:>10}" * 8).format(*heads)]
    for kind in [*sorted({trial.kind for trial in trials}), "all"]:
        some = [trial for trial in trials if kind in (trial.kind, "all")]
        repaired = Counter(trial.repaired for trial in some)
        counts = (
            len(some),
            sum(trial.found > 0 for trial in some),
            sum(not trial.found and trial.unchanged for trial in some),
            sum(trial.missed for trial in some),
            sum(bool(trial.wrong) for trial in some),
            repaired["mended"],
            repaired["said what is left"],
            repaired["nothing to do"],
        )
        lines.append(("{:18}" + " {:>10}" * 8).format(kind, *counts))
    lines += [
        f"trial {trial.number}: {trial.where}: {'missed ' * trial.missed}{'; '.join(trial.wrong)}"
        for trial in trials
        if trial.missed or trial.wrong
    ]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; returns 1 when something was missed or answered wrongly."""
    parser = argparse.ArgumentParser(
        prog="python -m lab.faults.flips", description=(__doc__ or "").partition("\n\n")[2]
    )
    parser.add_argument("--flips", type=int, default=1000, help="trials in all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="NDJSON of the trials; those that it has are not run again")
    arguments = parser.parse_args(argv)
    trials: list[Trial] = []
    if arguments.out is not None and arguments.out.exists():
        trials = [Trial(**json.loads(line)) for line in arguments.out.read_text().splitlines()]
    with tempfile.TemporaryDirectory(prefix="revisit-flips-") as folder:
        flips = Flips(Path(folder), arguments.seed)
        for number in sorted(set(range(arguments.flips)) - {trial.number for trial in trials}):
            trials.append(flips.run(number))
            if arguments.out is not None:
                with arguments.out.open("a") as file:
                    file.write(json.dumps(asdict(trials[-1])) + "\n")
    print(table(trials))
    return int(any(trial.missed or trial.wrong for trial in trials))


if __name__ == "__main__":
    sys.exit(main())
