"""A runtime of its own to measure, with a map for each preset."""

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from lab.evaluation.artist import ServiceArtist
from lab.evaluation.contender import Contender
from lab.evaluation.gallery import Artist
from lab.evaluation.querying import Retriever
from lab.evaluation.service import ServiceRetriever, map_of_its_own
from schemas.recipe import DescriptionParameters
from schemas.settings import Settings
from worker.description import vocabularies
from worker.description.describer import Describer
from worker.description.presets import Wanted, make_recipe
from worker.description.scheduler import Scheduler, field_alone
from worker.description.vocabularies import Vocabulary
from worker.encoders.choosing import make_encoder
from worker.runtime import MakeEncoder, Runtime, build


@contextmanager
def runtime_for_measuring(
    settings: Settings,
    device: str = "cpu",
    make_encoder: MakeEncoder = make_encoder,
    make_scheduler: type[Scheduler] = Scheduler,
) -> Iterator[Runtime]:
    """A started runtime with a data folder of its own, which is removed afterwards.

    Parameters
    ----------
    settings : Settings
        Encoder, weights and threads are taken from them; where they keep data is not touched.
    device : str
        Where networks run.
    make_encoder : function
        From settings and a number of threads to another encoder, such as a checkpoint in training.
    make_scheduler : type of Scheduler
        `lab.evaluation.once.DescribeOnce` where many maps get the same images.

    Raises
    ------
    SetupError
        The encoder cannot be loaded.
    """
    with tempfile.TemporaryDirectory(prefix="revisit-evaluation-") as folder:
        apart = {"data": Path(folder), "database": None, "images": None, "index": "faiss", "device": device}
        alone = {"inline_worker": True, "compare": False}
        runtime = build(
            settings.model_copy(update={**apart, **alone}), make_encoder=make_encoder, make_scheduler=make_scheduler
        )
        runtime.start()
        try:
            yield runtime
        finally:
            runtime.stop()


def contender(runtime: Runtime, preset: str, vocabulary: Vocabulary | None = None) -> Contender:
    """A preset of a runtime as something to be measured.

    Parameters
    ----------
    runtime : Runtime
    preset : str
    vocabulary : Vocabulary, optional
        Instead of the general one.

    Raises
    ------
    InvalidParameters
        There is no such preset, or the vocabulary does not fit it.
    """
    recipe = make_recipe(runtime.encoder, Wanted(), preset=preset, vocabulary=vocabulary)
    if vocabulary is not None:
        runtime.store.vocabularies.keep(vocabulary.digest, vocabulary.tensors)
    return Contender(partial(map_of_its_own, runtime, recipe, preset), _artist)


def train_vocabulary(
    runtime: Runtime, images: Iterable[Path], describer: Describer, parameters: DescriptionParameters
) -> Vocabulary:
    """Train a vocabulary on the static cells of images, and keep it where recipes can name it.

    Parameters
    ----------
    runtime : Runtime
        Started.
    images : iterable of Path
    describer : Describer
        Tells which cells are static.
    parameters : DescriptionParameters
        Sizes of the vocabulary, and its seed.

    Raises
    ------
    BadImage
    ValueError
        Too few images for these sizes.
    """
    decoded = (runtime.decode(path.read_bytes()) for path in images)
    fields = (runtime.scheduler.submit(image, field_alone, urgent=False).result().value for image in decoded)
    learned = vocabularies.train(fields, lambda field: describer.segment(field).static, parameters, parameters.seed)
    runtime.store.vocabularies.keep(learned.digest, learned.tensors)
    return learned


def _artist(retriever: Retriever) -> Artist | None:
    return ServiceArtist(retriever) if isinstance(retriever, ServiceRetriever) else None
