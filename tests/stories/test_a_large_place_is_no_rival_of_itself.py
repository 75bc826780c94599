"""What wrong answers get in a map is not measured on the place itself, however many views it has."""

from pathlib import Path

import numpy as np
import pytest

from schemas.records import Filters, ViewAttributes
from tests.sample_images import drawn, encoded, photo
from tests.stories.running import settings
from worker.description.presets import Wanted
from worker.runtime import build
from worker.service import comparing

OTHERS = ("quay", "mill", "park")


@pytest.mark.parametrize(("most", "views"), [(4000, 30), (10, 30)])
def test_a_place_of_more_views_than_searches_find_is_left_out_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int, views: int
) -> None:
    monkeypatch.setattr(comparing, "MOST_OWN", most)
    runtime = build(settings(tmp_path, compare=False))
    runtime.start()
    try:
        runtime.services.maps.put("town", Wanted(preset="paper", ranking={"candidates": 2}))
        enroll = runtime.services.enroll.enroll
        grain = np.random.default_rng(1)
        for number in range(views):
            seen = drawn(64, 48, 9).astype(int) + grain.integers(-6, 7, (48, 64, 3))
            look = encoded(np.clip(seen, 0, 255).astype(np.uint8))
            enroll(look, "town", ViewAttributes(place="hall", metadata={"number": number}), patience_s=60)
        for number, name in enumerate(OTHERS):
            enroll(photo(number), "town", ViewAttributes(place=name), patience_s=60)

        index, record = runtime.catalogue.index("town")
        seqs = [view.seq for view in runtime.store.views.list("town", Filters(), limit=100)[0]]
        made = runtime.comparer.compare(seqs, index, record.recipe, len(seqs))
        own = set(seqs[:views])
        for one in made:
            if one.seq in own and most < views:
                assert (one.level, one.rival, one.others) == (None, None, 0)
            elif one.seq in own:
                assert one.rival not in own
                assert one.others == len(OTHERS)
            assert one.own is None or one.own > 0.5
    finally:
        runtime.stop()
