"""How the node is, for /diagnostics: what is wrong, what to do about it, and when to try again."""

from dataclasses import dataclass, field

from revisit_client import ClientError, RevisitProblem, Unreachable

from revisit_ros.encoding import Unusable

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 1.0, 30.0
"""Between tries while the service is away; doubled each time."""

REFUSED_PAUSE_S = 10.0
"""Between tries after a refusal that only a person can mend."""


@dataclass(frozen=True)
class Trouble:
    """What a call met.

    Parameters
    ----------
    state : str
        ``service away``, ``service busy``, ``key refused``, ``map missing``, ``image refused`` or ``refused``.
    level : int
    detail, remedy : str
    pause_s : float or None
        Seconds to wait before the next call; None: longer each time.
    again : bool
        Whether the same call may succeed later.
    of_image : bool
        Whether the image itself may be why, so that it is not sent for ever.
    runs : bool
        Whether an earlier call with this Idempotency-Key still runs, as far as the service knows.
    """

    state: str
    level: int
    detail: str
    remedy: str
    pause_s: float | None = 0.0
    again: bool = False
    of_image: bool = False
    runs: bool = False


def trouble_of(error: Exception) -> Trouble:
    """What an exception of a call means."""
    if isinstance(error, Unusable):
        return Trouble("image refused", WARN, str(error), "see the message")
    if isinstance(error, Unreachable):
        remedy = "start it with `./revisit serve`, or set the parameter url to where it runs"
        return Trouble("service away", ERROR, str(error).partition(";")[0], remedy, None, again=True)
    if isinstance(error, RevisitProblem):
        return _trouble_of_problem(error)
    if isinstance(error, ClientError):
        return Trouble(
            "service away", ERROR, str(error), "set the parameter url to a revisit service", None, again=True
        )
    return Trouble("refused", ERROR, f"{type(error).__name__}: {error}", "report it: this is a fault of the node")


def _trouble_of_problem(problem: RevisitProblem) -> Trouble:
    detail = str(problem).replace("\n", " ")
    if problem.status == 401:
        remedy = "set the parameter key_file, or REVISIT_KEY, to a key that `./revisit keys create NAME` printed"
        return Trouble("key refused", ERROR, detail, remedy, REFUSED_PAUSE_S, again=True)
    if problem.code == "forbidden":
        remedy = "give the node a key with the scope read (localize) or write (enroll), and for this map"
        return Trouble("key refused", ERROR, detail, remedy, REFUSED_PAUSE_S, again=True)
    if problem.status == 403:
        return Trouble("refused", ERROR, detail, "call the service by another name: url", REFUSED_PAUSE_S, again=True)
    if problem.status == 404:
        remedy = "set the parameter map to one of `./revisit maps`, or enrol into it first"
        return Trouble("map missing", ERROR, detail, remedy, REFUSED_PAUSE_S)
    if problem.status == 409 and problem.replayed:
        remedy = "the map has this image with another time or position: look whether the camera sends the same again"
        return Trouble("image refused", WARN, detail, remedy)
    if problem.status in (408, 409):
        remedy = "look at the network between the node and the service; the node tries again"
        return Trouble("service busy", WARN, detail, remedy, None, again=True, runs=problem.status == 409)
    if problem.status in (429, 503):
        remedy = "lower the parameter rate, or raise the service's limits; the node waits and goes on"
        return Trouble("service busy", WARN, detail, remedy, problem.retry_after_s, again=True)
    if problem.status == 507:
        return Trouble("service busy", ERROR, detail, "make room on the service's disk", REFUSED_PAUSE_S, again=True)
    if problem.status >= 500:
        remedy, of_image = "look into the service's log", problem.status == 500
        return Trouble("service away", ERROR, detail, remedy, None, again=True, of_image=of_image)
    if problem.code == "invalid-parameter":
        return Trouble("refused", ERROR, detail, "change the parameter of the node that is named", REFUSED_PAUSE_S)
    return Trouble("image refused", WARN, detail, "look at what the camera sends")


class Link:
    """Whether calls get through, and when the next one may be made."""

    def __init__(self) -> None:
        self.trouble: Trouble | None = None
        self.failures = 0
        self._until = float("-inf")

    def allows(self, now: float) -> bool:
        """Whether a call may be made; `now` in seconds of a clock that never goes back."""
        return now >= self._until

    def succeeded(self) -> None:
        """A call got its answer."""
        self.trouble, self.failures = None, 0
        self._until = float("-inf")

    def failed(self, trouble: Trouble, now: float) -> None:
        """A call met trouble."""
        self.trouble = trouble
        self.failures += 1
        growing = min(LONGEST_PAUSE_S, FIRST_PAUSE_S * 2 ** min(self.failures - 1, 10))
        self._until = now + (growing if trouble.pause_s is None else trouble.pause_s)


@dataclass
class Report:
    """One status of /diagnostics."""

    level: int
    message: str
    values: dict[str, str] = field(default_factory=dict)


def report(
    link: Link,
    now: float,
    *,
    last_image: float | None,
    started: float,
    silence_s: float,
    topic: str,
    doing: str,
    note: str,
    values: dict[str, str],
) -> Report:
    """What /diagnostics is told.

    Parameters
    ----------
    link : Link
    now, started : float
        Seconds of one clock, which never goes back.
    last_image : float or None
        When the last image arrived.
    silence_s : float
        Without images for so long, that is told.
    topic : str
        Where they should come from.
    doing : str
        What is said where nothing is wrong.
    note : str
        What the node would do better with; a warning.
    values : dict
        Counts and times.
    """
    quiet_s = now - (started if last_image is None else last_image)
    if link.trouble is not None and link.trouble.level == ERROR:
        trouble = link.trouble
    elif quiet_s > silence_s:
        came = "none has come" if last_image is None else f"the last came {quiet_s:.0f} s ago"
        remedy = f"look whether `ros2 topic hz {topic}` sees any; remap the topic, or change image_transport"
        trouble = Trouble("no images", STALE, f"no images on {topic}: {came}", remedy)
    elif link.trouble is not None:
        trouble = link.trouble
    elif note:
        return Report(WARN, note, {"state": "working", **values})
    else:
        return Report(OK, doing, {"state": "working", **values})
    told = {"state": trouble.state, "remedy": trouble.remedy, "failures_in_a_row": str(link.failures)}
    return Report(trouble.level, trouble.detail, told | values)
