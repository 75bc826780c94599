"""Whether an encoder encodes, found out by trying."""

from schemas.errors import Busy, EncoderAway
from schemas.image import Image
from schemas.inference import PROBE
from worker.description.blame import PLAIN
from worker.description.scheduler import Scheduler, field_alone

SMALL = Image(PROBE[0], "0" * 64)
"""Takes little of the time of others, as long as nothing is wrong."""


def tried(scheduler: Scheduler, patience_s: float) -> str:
    """``ok`` once an image was encoded, or why it was not.

    Parameters
    ----------
    scheduler : Scheduler
    patience_s : float
        Seconds in which this image has to be encoded, or another one.
    """
    if not scheduler.alive:
        return "its thread has ended; restart the service"
    before = scheduler.encoded
    image = SMALL if scheduler.away is None else PLAIN
    try:
        scheduler.submit(image, field_alone, urgent=True).result(patience_s)
    except EncoderAway as error:
        return error.detail
    except Busy:
        return "ok"  # it works through as many images as may wait
    except TimeoutError:
        if scheduler.encoded == before:
            return f"it has encoded no image for {patience_s:.0f} s"
    except Exception as error:
        return f"it failed on a test image ({type(error).__name__}); the service's log has the reason"
    return "ok"
