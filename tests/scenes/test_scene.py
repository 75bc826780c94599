"""Drawn places stay the same from every viewpoint and in every lighting."""

import numpy as np
import pytest

from scenes import DYNAMIC, LABELS, Scene, scene

SMALL = (160, 120)


def share(labels: np.ndarray, label: str) -> float:
    return float((labels == LABELS.index(label)).mean())


def test_the_same_scene_is_the_same_image() -> None:
    first, second = Scene(3, size=SMALL).render(), Scene(3, size=SMALL).render()

    np.testing.assert_array_equal(first[0], second[0])
    np.testing.assert_array_equal(first[1], second[1])


@pytest.mark.parametrize("kind", ["street", "park", "corridor"])
@pytest.mark.parametrize("light", ["noon", "overcast", "dusk", "night"])
def test_every_kind_can_be_drawn_in_every_light(kind: str, light: str) -> None:
    pixels, labels = Scene(1, kind, size=SMALL).render(light=light)  # type: ignore[arg-type]

    assert pixels.shape == (120, 160, 3)
    assert pixels.dtype == np.uint8
    assert labels.shape == (120, 160)
    assert labels.max() < len(LABELS)
    assert pixels.std() > 8


def test_labels_do_not_depend_on_the_light() -> None:
    place = Scene(4, "street", size=SMALL)

    np.testing.assert_array_equal(place.render()[1], place.at("night").render()[1])


def test_night_is_darker_than_noon() -> None:
    place = Scene(4, size=SMALL)

    assert place.at("night").pixels.mean() < 0.5 * place.pixels.mean()


@pytest.mark.parametrize("thing", DYNAMIC)
def test_a_thing_in_front_hides_part_of_the_place_and_nothing_else_changes(thing: str) -> None:
    place = Scene(5, size=SMALL)
    _, empty = place.render()
    _, crossed = place.behind(thing).render()

    hidden = crossed == LABELS.index(thing)
    assert 0.003 < hidden.mean() < 0.7
    np.testing.assert_array_equal(empty[~hidden], crossed[~hidden])


def test_a_street_has_what_streets_have() -> None:
    seen = [Scene(seed, size=SMALL).render()[1] for seed in range(4)]

    for label in ("sky", "building", "road", "sidewalk"):
        assert np.mean([share(labels, label) for labels in seen]) > 0.03, label


def test_near_things_move_more_than_far_ones() -> None:
    """True parallax: a step aside shifts the near pavement, not the sky; turning shifts all alike."""
    place = Scene(5, size=SMALL)
    _, here = place.render()
    _, aside = place.seen_from(dx=1.0).render()

    changed = here != aside
    assert changed[70:].mean() + changed[:, :40].mean() > 0
    assert (here == aside).mean() > 0.5  # still the same place


def test_another_seed_is_another_place() -> None:
    one, other = (Scene(seed, size=SMALL).pixels.astype(int) for seed in (1, 2))

    assert np.abs(one - other).mean() > 15


def test_a_name_is_always_the_same_place() -> None:
    assert scene("square") == scene("square")
    assert scene("square") != scene("canal")
    assert scene("long corridor").kind == "corridor"
    assert scene("rose garden").kind == "park"


def test_the_fluent_form_reads_as_a_sentence() -> None:
    told = scene("square").at("dusk").behind("bus").seen_from(dx=1.0, turn=5)

    assert (told.light, told.things, told.viewpoint.dx, told.viewpoint.turn) == ("dusk", ("bus",), 1.0, 5)


def test_steps_add_up_along_the_way_one_looks() -> None:
    turned = scene("square").seen_from(turn=90).seen_from(ahead=2)

    assert turned.viewpoint.dx == pytest.approx(2)
    assert turned.viewpoint.ahead == pytest.approx(0, abs=1e-9)


def test_unknown_things_are_refused() -> None:
    with pytest.raises(ValueError, match="tram"):
        scene("square").behind("tram")
