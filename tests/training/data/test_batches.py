from pathlib import Path

import torch

from training.data import batches as data
from training.data.lexicon import ClipWords, Lexicon
from training.data.mix import Mix

MIX = Mix(strong=1, mild=1, clear=3, size=(32, 64), clear_size=(64, 96))


def batches_of(folder: Path) -> tuple[data.Batches, Lexicon]:
    lexicon = Lexicon(ClipWords(folder / data.CLIP_FILE), data.classes(folder))
    return data.Batches(data.sources(folder, None), lexicon, MIX, seed=1), lexicon


def test_clear_views_are_larger_and_always_labelled(data_folder: Path) -> None:
    batches, lexicon = batches_of(data_folder)

    for batch in map(batches.__getitem__, range(4)):
        assert batch["pictures"].shape == (4, 3, 32, 64)
        assert batch["clear_pictures"].shape == (3, 3, 64, 96)
        assert batch["clear_meanings"].shape == (3, 16, 24)
        assert batch["clear_sets"].tolist() == [lexicon.sets.index("camvid")] * 3
        assert bool((batch["clear_meanings"] >= 0).flatten(1).any(dim=1).all())


def test_clear_labels_lie_where_the_picture_shows_them(data_folder: Path) -> None:
    batches, lexicon = batches_of(data_folder)
    meanings = [meaning.words for meaning in lexicon.meanings]
    sky, road = meanings.index(("sky",)), meanings.index(("road", "street"))

    seen = [batches[step] for step in range(4)]
    light = torch.cat([batch["clear_pictures"].float().mean(dim=1) for batch in seen])[:, 2::4, 2::4]
    attributes = torch.cat([batch["clear_meanings"] for batch in seen])

    assert {-1, sky, road} >= set(attributes.flatten().tolist()) >= {sky, road}
    assert (
        float(light[attributes == sky].mean()) > float(light[attributes == road].mean()) + 30
    )  # drawn brighter by 120
