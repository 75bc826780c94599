"""Open an upload as what it is: an archive of images, a video, or a ROS 2 recording."""

from functools import partial
from pathlib import Path

from schemas.errors import BodyTooLarge, InvalidParameters, ParameterError
from schemas.imports import ImportOptions
from schemas.records import ViewAttributes
from worker.images.apart.bag import MAGIC, Bag
from worker.images.apart.video import Video, is_video
from worker.service.archives import MOST_FILES
from worker.service.bags import recording_of
from worker.service.recordings import Item, Limits, Note, Recording, open_archive
from worker.service.thinning import thin

LISTING = "listing.json"
"""Beside an upload that has to be read through to know what is in it: what is in it."""

VIDEO_EVERY_S = 1.0
"""Seconds from one frame of a video to the next, unless a caller says otherwise."""


def open_recording(path: Path, limits: Limits, options: ImportOptions) -> Recording:
    """Open an upload, by its content; what of it is not wanted is left out.

    Raises
    ------
    BadBody, BodyTooLarge, InvalidParameters
        Nothing of it can be imported.
    """
    with path.open("rb") as file:
        head = file.read(16)
    topics = [name for name in ("image_topic", "pose_topic") if getattr(options, name) is not None]
    if topics and not head.startswith(MAGIC):
        raise InvalidParameters([ParameterError(name, "is of use only with a recording of ROS 2") for name in topics])
    if is_video(head):
        return _video(path, limits, options)
    if head.startswith(MAGIC):
        return _bag(path, limits, options)
    recording = open_archive(path, limits)
    try:
        thin(recording, options)
    except BaseException:
        recording.close()
        raise
    return recording


def _bag(path: Path, limits: Limits, options: ImportOptions) -> Recording:
    bag = Bag(path, limits.image, options.image_topic, options.pose_topic, path.with_name(LISTING))
    recording = recording_of(bag)
    bag.wants(thin(recording, options))
    if len(recording.items) > MOST_FILES:
        raise BodyTooLarge(
            f"it holds {len(recording.items):,} images that are wanted; at most {MOST_FILES:,} are taken: see `every`"
        )
    return recording


def _video(path: Path, limits: Limits, options: ImportOptions) -> Recording:
    wrong = []
    if options.exif:
        wrong.append(ParameterError("exif", "is of no use with a video, whose frames have no EXIF"))
    if options.every_m is not None:
        detail = "choose by time, such as every=2s, or send its frames as images with a trajectory"
        wrong.append(ParameterError("every", f"a video does not say where it was taken: {detail}"))
    if wrong:
        raise InvalidParameters(wrong)
    every_s = options.every_s or VIDEO_EVERY_S
    video = Video(path, every_s, limits.image, limits.frame_s, path.with_name(LISTING))
    if len(video.times_s) > MOST_FILES:
        raise BodyTooLarge(
            f"with a frame every {every_s:g} s the video has {len(video.times_s):,}; at most {MOST_FILES:,} are taken"
        )
    items = [
        Item(f"{time:.3f} s", ViewAttributes(metadata={"video_s": round(time, 3)}), partial(video.read, number))
        for number, time in enumerate(video.times_s)
    ]
    notes = [] if video.broken is None else [Note("the file", "malformed-body", video.broken)]
    return Recording(video.close, items, notes=notes)
