"""What a store keeps of views that were compared with the other views of their map."""

from dataclasses import replace
from functools import partial

import pytest
import sqlalchemy as sa

from schemas.comparisons import Comparison, KnownView
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe, RankingConfig
from schemas.records import Position
from tests.storage.material import NOW, RECIPE, describe_all, enroll, recipe
from worker.storage.comparisons import SMALL
from worker.storage.store import SqlStore

ID = RECIPE.description.id


def compared(seq: int, among: int, level: float = 0.3, same_spot: tuple[int, ...] = ()) -> Comparison:
    return Comparison(seq, level, 0.04, same_spot, among, among - 1, rival=seq, breadth=1.5)


def replace_ranking(of: MapRecipe, ranking: RankingConfig) -> MapRecipe:
    return of.model_copy(update={"ranking": ranking})


def described(store: SqlStore, *names: str) -> list[int]:
    seqs = [enroll(store, name).view.seq for name in names]
    describe_all(store)
    return seqs


def due(store: SqlStore, sample: int = 100, count: int = 100, *, busy: bool = False) -> set[int]:
    found = store.comparisons.uncompared(sample, count, busy=busy)
    return set() if found is None else set(found.seqs)


def test_views_are_due_until_they_are_compared_and_again_when_the_map_has_doubled(store: SqlStore) -> None:
    first = described(store, "gate", "pond")
    assert due(store, busy=True) == set(first)
    store.comparisons.keep("campus", RECIPE, [compared(seq, 2) for seq in first], NOW)
    assert due(store, busy=True) == set()

    later = described(store, "stairs")
    assert due(store, busy=True) == set(later)
    store.comparisons.keep("campus", RECIPE, [compared(seq, 3) for seq in later], NOW)
    described(store, "hall")
    assert set(first) < due(store, busy=True)


def test_a_small_map_is_compared_again_whenever_it_changed_and_nothing_waits(store: SqlStore) -> None:
    first = described(store, "gate", "pond", "hall")
    store.comparisons.keep("campus", RECIPE, [compared(seq, 3) for seq in first], NOW)
    assert (due(store), store.comparisons.levels("campus").current) == (set(), 3)

    later = described(store, "stairs")
    store.comparisons.keep("campus", RECIPE, [compared(seq, 4) for seq in later], NOW)
    assert (due(store), due(store, busy=True)) == (set(first), set())
    levels = store.comparisons.levels("campus")
    assert (levels.compared, levels.current) == (4, 1)  # what was compared before counts until then

    store.removals.delete_view(store.views.at(later)[later[0]].id)
    assert due(store) == set()


def test_a_larger_map_waits_until_it_has_doubled(store: SqlStore) -> None:
    first = described(store, *(f"view {i}" for i in range(SMALL)))
    store.comparisons.keep("campus", RECIPE, [compared(seq, SMALL) for seq in first], NOW)
    later = described(store, "one more")
    assert due(store) == set(later)
    assert store.comparisons.levels("campus").current == SMALL


@pytest.mark.parametrize("replaced", [False, True])
def test_a_small_map_is_compared_again_when_a_view_gets_another_place_or_makes_room(
    store: SqlStore, replaced: bool
) -> None:
    """The same views give the same verdicts, however they came to their places."""
    seqs = described(store, "gate", "pond", "hall")
    store.comparisons.keep("campus", RECIPE, [compared(seq, 3) for seq in seqs], NOW)
    first = store.views.at(seqs)[seqs[0]]
    if replaced:
        store.removals.delete_view(first.id)
        seqs = [*seqs[1:], *described(store, "stairs")]
    else:
        store.views.change(first.id, lambda attributes: replace(attributes, metadata={"floor": 1}))
        store.comparisons.keep("campus", RECIPE, [compared(seqs[0], 3)], NOW)
        assert due(store) == set()  # it is where it was
        store.views.change(first.id, lambda attributes: replace(attributes, place="gate"))
    assert due(store) == set(seqs)
    levels = store.comparisons.levels("campus")
    assert (levels.compared, levels.current) == (2, 0)  # what was compared before counts until then
    store.comparisons.keep("campus", RECIPE, [compared(seq, 3) for seq in seqs], NOW)
    assert due(store) == set()


@pytest.mark.parametrize("by_another_recipe", [False, True])
def test_a_small_map_is_compared_again_when_a_view_comes_before_another_one_goes(
    store: SqlStore, by_another_recipe: bool
) -> None:
    """There are as many views as when the others were compared, but they are not the same."""
    seqs = described(store, "gate", "pond", "hall")
    store.comparisons.keep("campus", RECIPE, [compared(seq, 3) for seq in seqs], NOW)
    if by_another_recipe:
        store.jobs.switch_recipe("campus", replace_ranking(recipe("paper"), RECIPE.ranking), NOW)
        describe_all(store)
    [later] = described(store, "stairs")
    store.removals.delete_view(store.views.at(seqs)[seqs[0]].id)
    if by_another_recipe:
        store.jobs.switch_recipe("campus", RECIPE, NOW)
        describe_all(store)
    assert due(store) == {*seqs[1:], later}


def test_a_larger_map_compares_again_what_took_a_view_for_another_place_that_moved_or_went(store: SqlStore) -> None:
    seqs = described(store, *(f"view {i}" for i in range(SMALL + 3)))
    moved, went = seqs[0], seqs[1]
    rivals = {seqs[5]: moved, seqs[6]: went}
    rows = [replace(compared(seq, len(seqs)), rival=rivals.get(seq, seqs[9])) for seq in seqs]
    store.comparisons.keep("campus", RECIPE, rows, NOW)
    assert due(store) == set()

    views = store.views.at(seqs)
    store.views.change(views[moved].id, lambda attributes: replace(attributes, position=Position(x=1, y=2)))
    assert due(store) == {moved, seqs[5]}
    store.removals.delete_view(views[went].id)
    assert due(store) == {moved, seqs[5], seqs[6]}


def test_what_was_compared_while_a_view_got_another_place_or_went_is_not_kept(store: SqlStore) -> None:
    first, second, third = described(store, "gate", "pond", "hall")
    revision = store.maps.revision("campus")
    of = store.views.at([first, second])
    store.views.change(of[first].id, lambda attributes: replace(attributes, place="gate"))
    store.comparisons.keep("campus", RECIPE, [compared(seq, 3) for seq in (first, second)], NOW, revision)
    assert due(store) == {first, second, third}

    store.removals.delete_view(of[second].id)
    late = [replace(compared(third, 3), rival=second), compared(first, 2)]
    store.comparisons.keep("campus", RECIPE, late, NOW, store.maps.revision("campus"))
    assert due(store) == {third}


def test_of_many_maps_only_those_that_changed_are_looked_at_again(store: SqlStore) -> None:
    for i in range(20):
        for name in ("gate", "pond"):
            enroll(store, name, map=f"map {i}")
    describe_all(store)
    while (found := store.comparisons.uncompared(100, 100)) is not None:
        store.comparisons.keep(found.map, RECIPE, [compared(seq, found.among) for seq in found.seqs], NOW)
    statements: list[str] = []
    count = partial(lambda statements, *event: statements.append(event[2]), statements)
    sa.event.listen(store._database.engine, "before_cursor_execute", count)

    view = enroll(store, "hall", map="map 7").view
    describe_all(store)
    statements.clear()
    found = store.comparisons.uncompared(100, 100)
    assert found is not None
    assert (found.map, view.seq in found.seqs, found.among) == ("map 7", True, 3)
    assert len(statements) < 10
    store.comparisons.keep("map 7", RECIPE, [compared(seq, 3) for seq in found.seqs], NOW)
    statements.clear()
    assert store.comparisons.uncompared(100, 100) is None
    assert len(statements) < 10

    store.removals.delete_view(view.id)
    assert len(due(store)) == 2  # a small map that has other views by now


def test_the_only_view_of_a_map_has_nothing_to_be_compared_with(store: SqlStore) -> None:
    described(store, "gate")
    assert store.comparisons.uncompared(100, 100) is None


def test_views_of_one_place_alone_are_compared_too(store: SqlStore) -> None:
    seqs = described(store, "gate", "gate by night")
    store.comparisons.keep("campus", RECIPE, [Comparison(seq, None, None, (), 2, 0, own=0.8) for seq in seqs], NOW)
    levels = store.comparisons.levels("campus")
    assert (due(store), levels.current) == (set(), 2)
    assert levels.compared == 0  # they say nothing of wrong answers


def test_a_large_map_is_sampled_always_by_the_same_views(store: SqlStore) -> None:
    seqs = described(store, *(f"view {i}" for i in range(12)))
    sample = due(store, sample=5)
    assert len(sample) == 5 == len(due(store, sample=5) & set(seqs))
    assert due(store, sample=5, count=2) < sample
    store.comparisons.keep("campus", RECIPE, [compared(seq, 12) for seq in sample], NOW)
    assert due(store, sample=5) == set()
    assert len(due(store, sample=8)) == 3


def test_a_map_knows_the_means_over_its_compared_views(store: SqlStore) -> None:
    one, two, three = described(store, "gate", "pond", "stairs")
    assert (store.comparisons.levels("campus").compared, store.comparisons.levels("campus").breadth) == (0, None)
    rows = [compared(one, 3, 0.2), compared(two, 3, 0.4), Comparison(three, None, None, (), 3, 0)]
    store.comparisons.keep("campus", RECIPE, rows, NOW)
    levels = store.comparisons.levels("campus")
    assert levels.compared == 2
    assert [levels.level, levels.gap, levels.breadth] == pytest.approx([0.3, 0.04, 1.5])
    assert levels.others == pytest.approx(4 / 3)
    assert (levels.own, levels.paired) == (None, 0)
    own = [replace(row, own=score) for row, score in zip(rows[:2], (0.4, 0.8), strict=True)]
    store.comparisons.keep("campus", RECIPE, own, NOW)
    assert store.comparisons.levels("campus").own == pytest.approx(0.76)  # nine tenths of the way
    assert store.comparisons.levels("campus").paired == 2
    store.comparisons.keep("campus", RECIPE, rows, NOW)
    levels = store.comparisons.levels("campus")
    assert levels.updated_at == NOW


def test_levels_are_read_again_only_where_the_map_changed(store: SqlStore) -> None:
    one, two = described(store, "gate", "pond")
    store.comparisons.keep("campus", RECIPE, [compared(seq, 2) for seq in (one, two)], NOW)
    before = store.comparisons.levels("campus")
    assert store.comparisons.levels("campus") is before
    store.removals.delete_view(store.views.at([one])[one].id)
    assert store.comparisons.levels("campus").compared == 1


def test_means_are_the_same_in_whichever_order_views_were_compared(store: SqlStore) -> None:
    seqs = described(store, *(f"view {i}" for i in range(7)))
    rows = [replace(compared(seq, 7, 0.1 * seq % 1 + 0.003), breadth=1.1 / seq) for seq in seqs]
    found = []
    for order in (rows, rows[::-1], rows[3:] + rows[:3], rows[::2] + rows[1::2]):
        for row in order:
            store.comparisons.keep("campus", RECIPE, [row], NOW)
        levels = store.comparisons.levels("campus")
        found.append((levels.level, levels.gap, levels.breadth))
    assert len(set(found)) == 1


def test_comparisons_change_answers_and_so_the_revision(store: SqlStore) -> None:
    one, _ = described(store, "gate", "pond")
    before = store.maps.revision("campus")
    store.comparisons.keep("campus", RECIPE, [compared(one, 2)], NOW)
    assert store.maps.revision("campus") == before + 1


def test_what_is_known_of_views(store: SqlStore) -> None:
    one, two = described(store, "gate", "pond")
    store.comparisons.keep("campus", RECIPE, [compared(one, 2, same_spot=(two,))], NOW)
    view = store.views.at([one])[one]
    store.views.change(
        store.views.at([two])[two].id, lambda now: replace(now, place="pond", position=Position(x=1, y=2))
    )
    known = store.comparisons.known([one, two, 999], ID)
    assert known[one] == KnownView(view.attributes.place, view.attributes.position, frozenset({two}))
    assert known[two] == KnownView("pond", Position(x=1, y=2))
    assert 999 not in known


def test_a_view_that_moved_is_compared_again_and_a_deleted_one_is_forgotten(store: SqlStore) -> None:
    one, two = described(store, "gate", "pond")
    store.comparisons.keep("campus", RECIPE, [compared(one, 2), compared(two, 2)], NOW)
    ids = {seq: view.id for seq, view in store.views.at([one, two]).items()}
    store.views.change(ids[one], lambda now: replace(now, place="elsewhere"))
    assert due(store) == {one, two}
    store.removals.delete_view(ids[two])
    store.comparisons.keep("campus", RECIPE, [compared(two, 2)], NOW)  # finished after the deletion
    assert store.comparisons.levels("campus").compared == 0


def test_another_recipe_or_ranking_begins_anew_and_another_precision_does_not(store: SqlStore) -> None:
    seqs = described(store, "gate", "pond")
    store.comparisons.keep("campus", RECIPE, [compared(seq, 2) for seq in seqs], NOW)
    store.maps.change("campus", MapChanges(ranking=lambda now: now.ranking.model_copy(update={"precision": 0.99})))
    assert due(store) == set()
    store.maps.change(
        "campus", MapChanges(ranking=lambda now: now.ranking.model_copy(update={"full_resolution_top_k": 3}))
    )
    assert due(store) == set(seqs)
    store.comparisons.keep("campus", RECIPE, [compared(seq, 2) for seq in seqs], NOW)  # begun before the change
    assert store.comparisons.levels("campus").compared == 0
    changed = store.maps.get("campus").recipe
    store.comparisons.keep("campus", changed, [compared(seq, 2) for seq in seqs], NOW)
    assert (due(store), store.comparisons.levels("campus").compared) == (set(), 2)
    store.jobs.switch_recipe("campus", recipe("paper"), NOW)
    describe_all(store)
    assert due(store) == set(seqs)
    store.comparisons.keep("campus", changed, [compared(seqs[0], 2)], NOW)  # by the recipe of before
    assert store.comparisons.levels("campus").compared == 0


def test_who_goes_back_to_a_recipe_by_another_ranking_finds_no_other_scores_there(store: SqlStore) -> None:
    seqs = described(store, "gate", "pond")
    other = recipe("paper")
    back = replace_ranking(RECIPE, other.ranking)
    store.comparisons.keep("campus", RECIPE, [compared(seq, 2) for seq in seqs], NOW)
    store.jobs.switch_recipe("campus", replace_ranking(other, RECIPE.ranking), NOW)
    describe_all(store)
    store.jobs.switch_recipe("campus", RECIPE, NOW)
    assert store.comparisons.levels("campus").compared == 2  # by the same ranking they say what they said

    store.jobs.switch_recipe("campus", other, NOW)
    store.jobs.switch_recipe("campus", back, NOW)

    assert store.maps.get("campus").recipe == back
    assert (store.comparisons.levels("campus").compared, due(store)) == (0, set(seqs))


def test_a_shadow_is_compared_by_its_own_ranking_and_leaves_nothing_of_it(store: SqlStore) -> None:
    seqs, other = described(store, "gate", "pond"), recipe("paper")
    store.jobs.switch_recipe("campus", replace_ranking(other, RECIPE.ranking), NOW)
    describe_all(store)
    store.comparisons.keep("campus", store.maps.get("campus").recipe, [compared(seq, 2) for seq in seqs], NOW)
    store.jobs.switch_recipe("campus", RECIPE, NOW)

    store.jobs.begin_shadow("campus", other, 7, NOW)
    assert store.comparisons.levels("campus", other.description.id).compared == 0
    store.comparisons.keep("campus", other, [compared(seq, 2) for seq in seqs], NOW)
    store.jobs.discard_shadow("campus", NOW)
    store.jobs.switch_recipe("campus", replace_ranking(other, RECIPE.ranking), NOW)

    assert (store.comparisons.levels("campus").compared, due(store)) == (0, set(seqs))


def test_a_whole_description_is_read_back_as_it_was_stored(store: SqlStore) -> None:
    [seq] = described(store, "gate")
    whole = store.descriptions.whole(seq, RECIPE.description)
    assert whole is not None
    assert whole.cells.tolist() == store.descriptions.cells([seq], ID)[seq].tolist()
    changes = store.descriptions.since("campus", 0)
    assert [v for values in whole.vectors.values() for v in values.tolist()] == changes.vectors[0].tolist()
    assert store.descriptions.whole(seq + 1, RECIPE.description) is None


def test_a_comparison_that_does_not_name_its_rival_is_made_again(store: SqlStore) -> None:
    """Those that an earlier version made."""
    one, two, three = described(store, "gate", "pond", "stairs")
    nameless = [compared(one, 3), compared(two, 3), Comparison(three, None, None, (), 3, 0)]
    store.comparisons.keep("campus", RECIPE, [replace(nameless[0], rival=None), *nameless[1:]], NOW)
    assert due(store) == {one}
    assert store.comparisons.levels("campus").compared == 2


def test_a_comparison_whose_rival_a_version_before_deleted_is_made_again(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That version told nobody, and a map of many views is not compared anew when one goes."""
    first = described(store, *(f"view {i}" for i in range(SMALL + 2)))
    taken = [replace(compared(seq, len(first)), rival=first[0]) for seq in first[1:4]]
    store.comparisons.keep("campus", RECIPE, [*taken, *(compared(seq, len(first)) for seq in first[4:])], NOW)
    store.comparisons.keep("campus", RECIPE, [compared(first[0], len(first))], NOW)
    with monkeypatch.context() as before:
        before.setattr("worker.storage.removals.outdate", lambda *_: None)
        store.removals.delete_view(store.views.at(first)[first[0]].id)
    assert due(store) == set(first[1:4])

    store.comparisons.keep("campus", RECIPE, [compared(seq, len(first) - 1) for seq in first[1:4]], NOW)
    assert due(store) == set()


def test_a_comparison_that_does_not_know_how_broad_its_lead_is_is_made_again(store: SqlStore) -> None:
    """Those that an earlier version made; until then the map is taken for one like others."""
    one, two = described(store, "gate", "pond")
    store.comparisons.keep("campus", RECIPE, [replace(compared(seq, 2), breadth=None) for seq in (one, two)], NOW)
    assert due(store) == {one, two}
    levels = store.comparisons.levels("campus")
    assert (levels.compared, levels.breadth) == (2, None)
    store.comparisons.keep("campus", RECIPE, [compared(one, 2)], NOW)
    assert due(store) == {two}
    assert store.comparisons.levels("campus").breadth == 1.5


def test_a_survey_has_the_newest_views_with_their_comparisons(store: SqlStore) -> None:
    one, two, three = described(store, "gate", "pond", "stairs")
    made = replace(compared(two, 3, same_spot=(one,)), rival=three, own=0.4)
    store.comparisons.keep("campus", RECIPE, [made], NOW)

    views, described_views = store.comparisons.survey("campus", 2)

    assert described_views == 3
    assert [(view.seq, view.comparison) for view in views] == [(two, made), (three, None)]
    assert views[0].known.same_spot == {one}
    assert views[0].id == store.views.at([two])[two].id
