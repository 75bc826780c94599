"""What the node enroll does, without ROS: images with poses in, views out, one at a time and none twice."""

import uuid
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from revisit_client import Revisit
from revisit_client.wire import Enrolled

from revisit_ros.caller import Caller
from revisit_ros.frames import FORWARD, Transform, heading_of_yaw, yaw_of
from revisit_ros.health import Link, Report, Trouble, report, trouble_of
from revisit_ros.images import Shot
from revisit_ros.pacing import Pace, Stride, Waiting

MOST_WITHOUT_POSE = 10
"""Images that wait for their transform."""

MOST_FAILURES = 3
"""Times that the service may fail on one image, while it answers, before the next one is sent."""


@dataclass(frozen=True)
class Keyframe:
    """An image to enrol, and where its camera was."""

    shot: Shot
    x: float
    y: float
    z: float
    heading: float | None
    # Of its own: however often it is sent, it becomes one view.
    idempotency_key: str = field(default_factory=lambda: uuid.uuid4().hex)
    is_running: bool = False  # by the last answer, a call with this key

    def after(self, trouble: Trouble) -> "Keyframe":
        """What is sent again.

        A service keeps the key of a call for ten minutes that ended with its process. So what is said to run twice in
        a row gets another key; an image is one view of a map whatever its keys are.
        """
        if trouble.runs and self.is_running:
            return replace(self, idempotency_key=uuid.uuid4().hex, is_running=False)
        return replace(self, is_running=trouble.runs)


class Enroller:
    """Its methods are called in one thread, the executor's, and never wait.

    Parameters
    ----------
    revisit : Revisit
        With a time limit and no patience: what is tried again is decided here.
    values : dict
        `settings.ENROLL`.
    placed : callable
        The camera of an image in the map's frame when it was taken; None while that is not known.
    wake : callable
        Called in another thread when there is something for `enrolled`.
    clock : callable
        Seconds, never going back.
    """

    def __init__(
        self,
        revisit: Revisit,
        values: dict[str, Any],
        placed: Callable[[Shot], Transform | None],
        wake: Callable[[], None],
        clock: Callable[[], float],
    ) -> None:
        self._revisit, self._values, self._placed, self._clock = revisit, values, placed, clock
        self._pace = Pace(values["rate"])
        self._stride = Stride(values["every_metres"], values["every_degrees"])
        self._without_pose: Waiting[Shot] = Waiting(MOST_WITHOUT_POSE)
        self._waiting: Waiting[Keyframe] = Waiting(int(values["queue"]))
        self._link = Link()
        self._caller: Caller[Keyframe, Enrolled] = Caller(self._send, wake, clock)
        self._sending = False
        self._failures = 0  # of the service on the image that is sent
        self._started = clock()
        self._last_image: float | None = None
        self._last_view = ""
        self._warning = ""
        self._counts: Counter[str] = Counter()
        self._lost_s: float | None = None
        self.note = ""
        """What the node would do better with; told in /diagnostics."""

    def image(self, shot: Shot) -> None:
        """An image arrived."""
        self._last_image = shot.arrived
        self._counts["images_received"] += 1
        self._without_pose.put(shot)
        self.go_on()

    def go_on(self) -> None:
        """Place the images whose transforms have come since, and send what is due; called often."""
        now = self._clock()
        while (shot := self._without_pose.peek()) is not None:
            camera = self._placed(shot)
            if camera is None:
                if now - shot.arrived <= self._values["tf_wait"]:
                    break
                self._counts["images_without_transform"] += 1
                self._lost_s = now
            else:
                self._lost_s = None
                self._consider(shot, camera)
            self._without_pose.take()
        if not self._sending and self._link.allows(now) and (keyframe := self._waiting.take()) is not None:
            self._sending = True
            self._caller.start(keyframe)

    def enrolled(self) -> list[tuple[Shot, Enrolled]]:
        """All that was enrolled since the last time; sends the next one."""
        done = []
        now = self._clock()
        for outcome in self._caller.outcomes():
            self._sending = False
            if outcome.answer is not None:
                self._failures = 0
                self._link.succeeded()
                self._counts["enrolled" if outcome.answer.created else "already_there"] += 1
                self._last_view = outcome.answer.view.id
                self._warning = "; ".join(warning.code for warning in outcome.answer.warnings)
                self._counts["warned_of"] += bool(self._warning)
                done.append((outcome.job.shot, outcome.answer))
            elif outcome.error is not None:
                trouble = trouble_of(outcome.error)
                self._failures += trouble.of_image
                self._link.failed(trouble, now)
                if trouble.again and self._failures < MOST_FAILURES:
                    self._waiting.put_back(outcome.job.after(trouble))
                else:
                    self._failures = 0
                    self._counts["refused"] += 1
        self.go_on()
        return done

    def report(self) -> Report:
        """For /diagnostics."""
        counts = ("images_received", "images_without_transform", "enrolled", "already_there", "refused", "warned_of")
        values = {name: str(self._counts[name]) for name in counts}
        values |= {"views_waiting": str(len(self._waiting) + self._sending)}
        values |= {"views_dropped": str(self._waiting.dropped + self._without_pose.dropped)}
        values |= {"map": self._values["map"], "url": self._revisit.url, "last_view": self._last_view}
        values |= {"last_warning": self._warning}
        return report(
            self._link,
            self._clock(),
            last_image=self._last_image,
            started=self._started,
            silence_s=self._values["silence"],
            topic=self._values["topic"],
            doing=f"{self._counts['enrolled']} views enrolled",
            note=self.note if self._lost_s is not None else "",
            values=values,
        )

    def close(self) -> None:
        """Stop, with the enrolment that runs, if it does not hang."""
        self._caller.close(1.0)

    def _consider(self, shot: Shot, camera: Transform) -> None:
        """Keep an image as a view, if it is far enough from the last one."""
        yaw = yaw_of(camera, FORWARD[self._values["camera_forward"]])
        heading = None if yaw is None else heading_of_yaw(yaw)
        position = camera.x, camera.y, camera.z
        if not self._stride.far_enough(position, heading) or not self._pace.due(shot.arrived):
            return
        self._stride.take(position, heading)
        self._pace.take(shot.arrived)
        self._waiting.put(Keyframe(shot, *position, heading))

    def _send(self, keyframe: Keyframe) -> Enrolled:
        """In the caller's thread."""
        shot = keyframe.shot
        return self._revisit.enroll(
            shot.read(),
            map=self._values["map"],
            place=self._values["place"] or None,
            x=keyframe.x,
            y=keyframe.y,
            z=keyframe.z,
            heading=keyframe.heading,
            captured_at=shot.captured_at(),
            metadata={"stamp": shot.stamp, "frame": shot.frame},
            idempotency_key=keyframe.idempotency_key,
        )
