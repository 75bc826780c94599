"""Whether enrolled images find themselves."""

import io
import random
from typing import TYPE_CHECKING, Any

from app.cli.output import progress_bar

if TYPE_CHECKING:
    from revisit_client import Revisit

SAMPLE = 20
"""Images of a map that are queried, unless all are."""

TIE = 1e-6
"""Scores at most this far apart are equal."""

NO_IMAGE = ("image-not-kept", "not-found")
"""Problems of a view that nothing can be asked with: its map keeps no images, or it was deleted meanwhile."""

SIDE, ALIKE = 32, 4.0
"""Two images are one photo when, scaled to this many pixels a side, they differ by at most this many grey levels."""


def audit(revisit: "Revisit", name: str, *, every: bool, quiet: bool) -> dict[str, Any]:
    """Query a map with its own images: each has to be its own best match, or tie with it, or lose to the same photo.

    Parameters
    ----------
    revisit : Revisit
    name : str
        Of the map.
    every : bool
        Query with all images instead of `SAMPLE`.
    quiet : bool
        Show no progress.

    Returns
    -------
    dict
        ``queried`` (those with an image), ``found``, and ``findings``, a line each.
    """
    from revisit_client import ClientError, RevisitProblem

    views = list(revisit.views(name, state="ready"))
    chosen = views if every or len(views) <= SAMPLE else random.Random(0).sample(views, SAMPLE)
    findings, gone = [], 0
    with progress_bar(len(chosen), f"images of map {name} queried for themselves", quiet=quiet) as step:
        for view in chosen:
            try:
                image = revisit.image(view.id)
                matches = revisit.query(image, map=name, top=20).matches
                best = [match.view.id for match in matches if match.score >= matches[0].score - TIE]
                if view.id not in best and not (best and _same_photo(image, revisit.image(best[0]))):
                    findings.append(f"view {view.id} does not find itself; enrol its image again")
            except (ClientError, OSError) as error:
                if isinstance(error, RevisitProblem) and error.code in NO_IMAGE:
                    gone += 1
                else:
                    findings.append(f"view {view.id}: {error}")
            step(view.id)
    queried = len(chosen) - gone
    return {"queried": queried, "found": queried - len(findings), "findings": findings}


def _same_photo(one: bytes, other: bytes) -> bool:
    """Whether two files hold one photo, in whatever format."""
    first, second = _small(one), _small(other)
    return sum(abs(a - b) for a, b in zip(first, second, strict=True)) <= ALIKE * len(first)


def _small(image: bytes) -> bytes:
    from PIL import Image, ImageOps

    upright = ImageOps.exif_transpose(Image.open(io.BytesIO(image)))
    return upright.convert("L").resize((SIDE, SIDE), Image.Resampling.BOX).tobytes()
