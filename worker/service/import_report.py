"""What came of an import: counts, and what was wrong with single images."""

from dataclasses import asdict, dataclass, field

from schemas.records import JobProgress
from worker.service.recordings import Note

MOST_NOTES = 1000
"""Notes that a report lists; the others are counted."""


@dataclass
class Report:
    """What came of an import so far; its fields are those of the job's `result`."""

    images: int = 0
    enrolled: int = 0
    already_there: int = 0
    failed: int = 0
    left_out: int = 0
    poor: int = 0
    rows_without_file: int = 0
    files_without_row: int = 0
    errors: list[dict[str, str]] = field(default_factory=list)
    errors_left_off: int = 0

    def add(self, note: Note) -> None:
        """List what was wrong with a file, or count it."""
        if len(self.errors) < MOST_NOTES:
            self.errors.append(asdict(note))
        else:
            self.errors_left_off += 1

    @property
    def progress(self) -> JobProgress:
        """Images that are done, of all."""
        return JobProgress(self.enrolled + self.already_there + self.failed, self.images)
