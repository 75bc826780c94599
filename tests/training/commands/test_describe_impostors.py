"""Pictures of no place of any map are described once and ship with the encoder."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from scenes import scene
from scenes.placeless import KINDS
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from schemas.settings import Settings
from training.commands.describe_impostors import EVERY, OF_A_KIND, described, main, mirrored
from worker.description import impostors
from worker.description.describer import Describer
from worker.description.presets import Wanted, general_vocabulary, make_recipe
from worker.description.vocabularies import Vocabulary, train
from worker.encoders.choosing import SHAREABLE, make_encoder
from worker.method.impostors import Impostors
from worker.method.vocabulary import ChannelVocabulary


def recipe_of(encoder: str, **wanted: object) -> DescriptionRecipe:
    made, _ = make_encoder(Settings(encoder=encoder), 1)
    return make_recipe(made, Wanted(**wanted), preset="default").description  # type: ignore[arg-type]


def none_needed(digest: str) -> Vocabulary:
    raise AssertionError(f"the vocabulary {digest} is not theirs")


def shipped_for(recipe: DescriptionRecipe) -> Impostors | None:
    return impostors.shipped_for(recipe, none_needed)


def read_from(path: Path) -> Impostors | None:
    """What the service would read if the impostors of `compact` were there."""
    impostors.read.cache_clear()
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(impostors, "path_of", lambda encoder: path)
            return shipped_for(recipe_of("compact"))
    finally:
        impostors.read.cache_clear()


@pytest.mark.parametrize("encoder", SHAREABLE)
def test_those_that_ship_are_of_the_recipe_that_maps_get(encoder: str) -> None:
    recipe = recipe_of(encoder)
    shipped = shipped_for(recipe)
    grid = recipe.parameters.dense

    assert shipped is not None
    assert grid is not None
    assert shipped.full.shape[1:3] == (grid.rows, grid.columns)
    assert OF_A_KIND * len(KINDS) == shipped.placeless < len(shipped.full)
    assert {len(of) for of in shipped.vectors.values()} == {len(shipped.full)}
    assert {name: of.shape[1] for name, of in shipped.vectors.items()} == {
        name: channel.length for name, channel in recipe.parameters.channels.items()
    }
    assert shipped.full.reshape(len(shipped.full), -1).any(axis=1).all()


def test_other_labels_change_nothing_and_other_cells_have_none() -> None:
    recipe = recipe_of("compact")
    assert shipped_for(recipe_of("compact", labels=("road", "building", "sky"))) is not None
    assert shipped_for(recipe_of("compact", parameters={"dense": {"rows": 8}})) is None
    assert shipped_for(recipe.model_copy(update={"weights": "0" * 64})) is None
    assert shipped_for(recipe_of("color")) is None


def test_for_a_vocabulary_of_ones_own_their_cells_are_carried_over() -> None:
    encoder, _ = make_encoder(Settings(encoder="compact"), 1)
    recipe = make_recipe(encoder, Wanted(), preset="default").description
    images = [Image.of(scene(f"vocabulary {n}", ("street", "park")[n % 2]).pixels) for n in range(12)]
    parameters = recipe.parameters.model_copy(
        update={
            "channels": {
                name: channel.model_copy(update={"vocabulary_size": 16, "dimensions": 8})
                for name, channel in recipe.parameters.channels.items()
            }
        }
    )
    own = recipe.model_copy(update={"parameters": parameters})
    general = Describer(encoder, recipe, general_vocabulary(encoder, "default"))
    learned = train(encoder.encode(images), lambda field: general.segment(field).static, parameters, 0)
    own = own.model_copy(update={"vocabulary": learned.digest})

    carried = impostors.shipped_for(own, {learned.digest: learned}.__getitem__)

    assert carried is not None
    assert carried.vectors == {}
    drawn = described(encoder, Describer(encoder, own, learned), 1).full.astype(np.float32)
    ours = carried.full[: carried.placeless : OF_A_KIND].astype(np.float32)
    cosines = (ours * drawn).sum(-1) / np.maximum(np.linalg.norm(ours, axis=-1) * np.linalg.norm(drawn, axis=-1), 1)
    assert np.median(cosines) > 0.9

    words_alone = {name: ChannelVocabulary(channel.words) for name, channel in learned.channels.items()}
    assert impostors.shipped_for(own, lambda digest: Vocabulary(words_alone)) is None


def test_the_command_writes_what_the_service_reads(tmp_path: Path) -> None:
    to = tmp_path / "some.safetensors"
    main(["--encoder", "compact", "--of-a-kind", "1", "--to", str(to)])
    shipped = shipped_for(recipe_of("compact"))
    made = read_from(to)

    assert made is not None
    assert shipped is not None
    assert made.placeless == len(made.full)
    off = np.abs(made.full.astype(int) - shipped.full[: shipped.placeless : OF_A_KIND])
    assert off.max() <= 1  # where another processor rounds the other way
    assert np.count_nonzero(off) < off.size / 10_000


def test_photographs_are_places_elsewhere_in_the_mirror(tmp_path: Path) -> None:
    free, to = tmp_path / "free", tmp_path / "some.safetensors"
    upright, wide, left_out = (scene(f"elsewhere {n}", "street").pixels for n in range(3))
    for folder, pixels in (("one", wide[:, ::-1]), ("two", upright[:, 50:300]), ("by-sa/three", left_out)):
        for number in range(EVERY):
            path = free / folder / f"{number:04}.jpg"
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), pixels[..., ::-1] if number == 0 else np.zeros_like(pixels))

    first, second = mirrored(free)
    main(["--encoder", "compact", "--of-a-kind", "1", "--free", str(free), "--to", str(to)])

    assert first.shape == wide.shape
    assert np.abs(first.astype(int) - wide).mean() < 5
    across, down = impostors.EXTENT
    assert second.shape[0] == pytest.approx(250 * down / across, abs=1)
    found = read_from(to)
    assert found is not None
    assert (found.placeless, len(found.full)) == (len(KINDS), len(KINDS) + 2)
