"""The node enroll: images of a robot that knows where it is become views of a map."""

import sys

from revisit_ros.enroller import Enroller
from revisit_ros.frames import Transform
from revisit_ros.images import Shot
from revisit_ros.landmarks import Landmarks
from revisit_ros.messages import landmark_message
from revisit_ros.node import TELL_S, RevisitNode, message_type, run
from revisit_ros.settings import ENROLL

TICK_S = 0.05


class EnrollNode(RevisitNode):
    """Every so many metres a view, with the position of its camera from TF at the image's stamp."""

    def __init__(self) -> None:
        super().__init__("enroll", ENROLL)
        values = self.values
        self._landmark = None
        if values["landmarks"]:
            self._landmark_type = message_type("rtabmap_msgs", "msg", "LandmarkDetection", "landmarks:=true")
            self._landmark = self.create_publisher(self._landmark_type, "landmark_detection", 10)
        self._landmarks = Landmarks(values["landmark_radius"])
        self._guard = self.create_guard_condition(self._enrolled)
        self.listen(lambda shot: self.enroller.image(shot))
        self.enroller = Enroller(self.revisit, values, self._camera, self._guard.trigger, self.clock)
        self._tick = self.create_timer(TICK_S, self._enrolled)
        self._telling = self.create_timer(TELL_S, lambda: self.tell(self.enroller.report()))

    def close(self) -> None:
        """Stop what runs beside the executor."""
        self.enroller.close()
        self.revisit.close()

    def _camera(self, shot: Shot) -> Transform | None:
        """Where the camera of an image is in the map."""
        placed = self.placed(shot, self.values["map_frame"])
        if placed is None:
            self.enroller.note = (
                f"no transform from {shot.frame!r} to {self.values['map_frame']!r} at the images' stamps: start what "
                "localises the robot, or set map_frame; without it nothing is enrolled"
            )
        return placed

    def _enrolled(self) -> None:
        """Tell RTAB-Map what became a view, and go on."""
        for shot, enrolled in self.enroller.enrolled():
            if self._landmark is not None and (landmark := self._landmarks.enrolled(enrolled.view)) is not None:
                self._landmark.publish(landmark_message(self._landmark_type, landmark, shot))


def main() -> None:
    """The executable."""
    sys.exit(run(EnrollNode))
