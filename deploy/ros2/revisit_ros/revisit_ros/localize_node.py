"""The node localize: images in, the pose of the place that they show out."""

import sys
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String
from std_srvs.srv import Trigger
from tf2_ros import TransformBroadcaster

from revisit_ros.correction import Correction, map_to_odom
from revisit_ros.frames import FORWARD
from revisit_ros.images import Shot
from revisit_ros.landmarks import Landmarks
from revisit_ros.localizer import Answered, Localizer
from revisit_ros.messages import (
    classification_message,
    landmark_message,
    place_message,
    pose_message,
    transform_message,
)
from revisit_ros.node import TELL_S, RevisitNode, message_type, run
from revisit_ros.pacing import HandOver
from revisit_ros.pose import UNKNOWN, NoPose, Pose, guess_of, pose_of
from revisit_ros.settings import LOCALIZE

TRIGGER = "visual_localization/trigger_localization"
TICK_S = 0.1

SERVICES = {
    "service": ("nav2_msgs", "SetInitialPose", "set_initial_pose", "Nav2's amcl"),
    "autoware": (
        "autoware_localization_msgs",
        "InitializeLocalization",
        "localization/initialize",
        "Autoware's pose_initializer",
    ),
}
"""Values of hand_over that call a service: its package, type and name, and what offers it."""

LATE_S = 1.0
"""Seconds after an answer that odometry's transform at the image's stamp is waited for."""


class LocalizeNode(RevisitNode):
    """Publishes only what matched, with the stamp of its image; on request, the transform from map to odom too."""

    def __init__(self) -> None:
        super().__init__("localize", LOCALIZE)
        values = self.values
        self._hand_over = HandOver(values["hand_over_every"])
        self._handed: tuple[Any, float] | None = None
        self._initial_pose: Any = None
        self._initial_pose_client: Any = None
        self._landmark: Any = None
        if values["hand_over"] == "topic":
            self._initial_pose = self.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
        elif values["hand_over"] in SERVICES:
            package, kind, self._taker, self._start = SERVICES[values["hand_over"]]
            self._service_type = message_type(package, "srv", kind, f"hand_over:={values['hand_over']}")
            self._initial_pose_client = self.create_client(self._service_type, self._taker)
        if values["landmarks"]:
            self._landmark_type = message_type("rtabmap_msgs", "msg", "LandmarkDetection", "landmarks:=true")
            self._landmark = self.create_publisher(self._landmark_type, "landmark_detection", 10)
        self._classification: Any = None
        if values["classification"]:
            kinds = ("Classification", "ObjectHypothesis")
            self._kinds = [message_type("vision_msgs", "msg", kind, "classification:=true") for kind in kinds]
            self._classification = self.create_publisher(self._kinds[0], "~/classification", 10)
        self._landmarks = Landmarks(values["landmark_radius"])
        self._pose = self.create_publisher(PoseWithCovarianceStamped, "~/pose", 10)
        self._place = self.create_publisher(String, "~/place", 10)
        self._trigger = self.create_service(Trigger, TRIGGER, self._triggered)
        self._hint = self.create_subscription(PoseWithCovarianceStamped, TRIGGER, self._hinted, 10)
        self._hint_note = ""
        self._correction = Correction(values["transform_hold"])
        self._late: tuple[Pose, Shot, float] | None = None
        self._broadcast = False
        if values["publish_tf"]:
            self._broadcaster = TransformBroadcaster(self)
            self._broadcasting = self.create_timer(1 / values["transform_rate"], self._send_transform)
        self._guard = self.create_guard_condition(self._answered)
        self.listen(lambda shot: self.localizer.image(shot))
        self.localizer = Localizer(self.revisit, values, self._guard.trigger, self.clock)
        self._tick = self.create_timer(TICK_S, self._answered)
        self._telling = self.create_timer(TELL_S, self._tell)

    def close(self) -> None:
        """Stop what runs beside the executor."""
        self.localizer.close()
        self.revisit.close()

    def _tell(self) -> None:
        report = self.localizer.report()
        self.tell(self._correction.added_to(report, self.clock()) if self.values["publish_tf"] else report)

    def _triggered(self, request: Any, response: Any) -> Any:
        self._wish()
        response.success, response.message = self.localizer.trigger()
        return response

    def _wish(self) -> None:
        """The next pose is to be handed over, also where an earlier one is still on its way."""
        self._hand_over.triggered()
        self._handed = None

    def _hinted(self, message: PoseWithCovarianceStamped) -> None:
        """A guess of the pose, and a trigger."""
        self._hint_note = ""
        if message.header.frame_id != self.values["map_frame"]:
            self._hint_note = (
                f"the pose on {TRIGGER} is in {message.header.frame_id!r}, not in {self.values['map_frame']!r}: "
                "it was not used"
            )
        else:
            at = message.pose.pose.position
            try:
                self.localizer.guess(guess_of(at.x, at.y, [float(number) for number in message.pose.covariance]))
            except ValueError as error:
                self._hint_note = f"the pose on {TRIGGER} was not used: {error}"
        if self._hint_note:
            self.localizer.note = self._hint_note
            self.get_logger().warning(self._hint_note)
        self._wish()
        self.localizer.trigger()

    def _answered(self) -> None:
        """Publish what the service answered meanwhile."""
        for found in self.localizer.answers():
            self._publish(found)
        if self._late is not None:
            self._correct(*self._late)
        if self._handed is not None and self.clock() - self._handed[1] > self.values["timeout"]:
            self._initial_pose_client.remove_pending_request(self._handed[0])
            self._handed = None

    def _publish(self, found: Answered) -> None:
        shot, values = found.shot, self.values
        if found.answer.status != "matched":
            return
        base = values["base_frame"]
        mount = self.placed(shot, base) if base else None
        pose = pose_of(found.answer, mount, FORWARD[values["camera_forward"]], base_wanted=bool(base))
        if found.answer.places and found.answer.places[0].place is not None:
            self._place.publish(place_message(found.answer.places[0].place))
        if self._classification is not None and found.answer.places:
            kind, hypothesis = self._kinds
            self._classification.publish(classification_message(kind, hypothesis, found.answer, shot))
        if self._landmark is not None and (landmark := self._landmarks.recognised(found.answer)) is not None:
            self._landmark.publish(landmark_message(self._landmark_type, landmark, shot))
        if isinstance(pose, NoPose):
            self.localizer.note = f"no pose: {pose.detail}; {pose.remedy}"
            return
        message = pose_message(pose, shot, values["map_frame"])
        self._pose.publish(message)
        self.localizer.published += 1
        if values["publish_tf"]:
            self._correct(pose, shot, self.clock())
        handed = self._hand(message) if pose.variances[0] < UNKNOWN else ""
        notes = [pose.note and f"{pose.note} ({shot.frame!r} in {base!r})" if mount is None and base else pose.note]
        self.localizer.note = "; ".join(filter(None, (*notes, handed, self._hint_note)))

    def _correct(self, pose: Pose, shot: Shot, answered: float) -> None:
        """Publish another transform from map to odom from now on, or tell why not."""
        values = self.values
        map_frame, odom, base = values["map_frame"], values["odom_frame"], values["base_frame"]
        self._late = None
        placed = self.placed(shot, odom, base)
        if placed is None:
            if self.clock() - answered < LATE_S:
                self._late = pose, shot, answered
            else:
                self._correction.note = (
                    f"no map to odom: TF does not place {base!r} in {odom!r} at the images' stamps; start odometry, "
                    "or set odom_frame"
                )
            return
        found = map_to_odom(pose, placed)
        if isinstance(found, NoPose):
            self._correction.note = f"{found.detail}; {found.remedy}"
        elif not self._broadcast and self.is_placed_now(map_frame, odom):
            self._correction.note = (
                f"no map to odom: somebody else publishes where {odom!r} is in {map_frame!r}; one of the two has to "
                "stop: set publish_tf to false, or end the other"
            )
        else:
            self._correction.take(found, shot.arrived)
            self._send_transform()

    def _send_transform(self) -> None:
        """The transform that holds, stamped ahead of the clock, so that it is there when it is asked for."""
        transform = self._correction.current(self.clock())
        if transform is not None:
            values, self._broadcast = self.values, True
            stamp = self.ahead(values["transform_tolerance"])
            message = transform_message(transform, values["map_frame"], values["odom_frame"], stamp)
            self._broadcaster.sendTransform(message)

    def _hand(self, message: PoseWithCovarianceStamped) -> str:
        """Hand a pose over, if one is wanted; why not, where nobody takes it."""
        if not self._hand_over.wanted:
            return ""
        if self._initial_pose is not None:
            if self._initial_pose.get_subscription_count() == 0:
                return "nobody listens to initialpose; the next pose is handed over again"
            self._initial_pose.publish(message)
            self._hand_over.handed()
        elif self._initial_pose_client is not None and self._handed is None:
            if not self._initial_pose_client.service_is_ready():
                return f"nobody offers {self._taker}; the next pose is handed over again (start {self._start})"
            request = self._service_type.Request()
            if self.values["hand_over"] == "autoware":
                request.pose_with_covariance = [message]  # the method stays AUTO: a place is a guess to start from
            else:
                request.pose = message
            future = self._initial_pose_client.call_async(request)
            self._handed = future, self.clock()
            future.add_done_callback(self._handed_over)
        return ""

    def _handed_over(self, future: Any) -> None:
        if self._handed is None or self._handed[0] is not future:
            return
        self._handed = None
        status = None if future.cancelled() or future.exception() else getattr(future.result(), "status", None)
        if future.cancelled() or future.exception() is not None:
            self.get_logger().warning(f"{self._taker} failed: {future.exception()}")
        elif status is not None and not status.success:  # Autoware's, while the vehicle moves for example
            self.get_logger().warning(f"{self._taker} refused the pose ({status.code}): {status.message}")
        else:
            self._hand_over.handed()


def main() -> None:
    """The executable."""
    sys.exit(run(LocalizeNode))
