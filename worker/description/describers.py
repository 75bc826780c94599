"""Describers by recipe: built once, shared by queries and enrolments."""

import logging
from collections.abc import Iterable

from schemas.errors import NotFound, SetupError
from schemas.latest import Latest
from schemas.recipe import DescriptionRecipe
from worker.description.describer import Describer
from worker.description.impostors import shipped_for
from worker.description.ports import Encoder, VocabularyReader
from worker.description.vocabularies import Vocabulary
from worker.method.byte_vectors import Product, float_product
from worker.method.impostors import Impostors

log = logging.getLogger("revisit.worker")

KEPT = 32
"""Describers kept; with more recipes in use the least recently used are built again, in milliseconds."""


class Describers:
    """Loads the vocabulary that a recipe names and builds its describer.

    Parameters
    ----------
    encoder : Encoder
    vocabularies : VocabularyReader
        Vocabularies that were trained on maps.
    general : iterable of Vocabulary
        Vocabularies that ship with the encoder.
    product : Product
    """

    def __init__(
        self,
        encoder: Encoder,
        vocabularies: VocabularyReader,
        general: Iterable[Vocabulary],
        product: Product = float_product,
    ) -> None:
        self._encoder = encoder
        self._vocabularies = vocabularies
        self._product = product
        self._general = {vocabulary.digest: vocabulary for vocabulary in general}
        self._made: Latest[str, Describer] = Latest(KEPT)
        self._impostors: Latest[str, Impostors | None] = Latest(KEPT)
        self._refused: set[str] = set()  # recipes without a describer, of which the log knows

    def of(self, recipe: DescriptionRecipe) -> Describer:
        """The describer of a recipe.

        Raises
        ------
        SetupError
            The recipe was made with another encoder or other weights, or its vocabulary is gone.
        """
        return self._made.get_or_make(recipe.id, lambda: self._describer(recipe))

    def has(self, recipe: DescriptionRecipe) -> bool:
        """Whether there is a describer of a recipe; where there is none, that is logged once."""
        try:
            self.of(recipe)
        except SetupError as error:
            if recipe.id not in self._refused:
                self._refused.add(recipe.id)
                log.error(
                    "images wait that another worker has to describe: %s", error.detail, extra={"event": "not_served"}
                )
            return False
        return True

    def impostors(self, recipe: DescriptionRecipe) -> Impostors | None:
        """The impostors that queries of maps with a recipe are compared with; None where there are none."""
        return self._impostors.get_or_make(recipe.id, lambda: self._shipped_for(recipe))

    def _describer(self, recipe: DescriptionRecipe) -> Describer:
        if (recipe.encoder, recipe.weights) != (self._encoder.name, self._encoder.digest):
            raise SetupError(
                f"this recipe needs the encoder {recipe.encoder} with weights {recipe.weights[:12]}; running is "
                f"{self._encoder.name} with {self._encoder.digest[:12]}; start that one, or give the map a new recipe"
            )
        vocabulary = self._vocabulary(recipe.vocabulary)
        vocabulary.check(recipe.parameters, self._encoder.layers)
        return Describer(self._encoder, recipe, vocabulary, self._product)

    def _shipped_for(self, recipe: DescriptionRecipe) -> Impostors | None:
        try:
            return shipped_for(recipe, self._vocabulary)
        except SetupError:  # of another encoder than the running one, by a vocabulary that ships with that
            return None

    def _vocabulary(self, digest: str) -> Vocabulary:
        if digest in self._general:
            return self._general[digest]
        try:
            return Vocabulary.read(self._vocabularies.get(digest), f"vocabulary {digest[:12]}")
        except NotFound:
            raise SetupError(f"the vocabulary {digest[:12]} is not kept here; train the map another one") from None
