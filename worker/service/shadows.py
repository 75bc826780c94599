"""Shadows: another recipe answers a map's queries beside the present one, before the map changes over to it."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Protocol

import numpy as np

from schemas.description import Description
from schemas.errors import (
    BadImage,
    EncoderAway,
    JobStopped,
    LeaseLost,
    NotFound,
    NothingStatic,
    RevisitError,
    SetupError,
    unforeseen,
)
from schemas.image import Image
from schemas.inbox import KeptQuery
from schemas.recipe import DescriptionRecipe, MapRecipe
from schemas.records import Changes, JobProgress, JobRecord, MapClaim, MapRecord, Sequence64, ViewRecord
from schemas.shadow import ShadowQuery, ShadowRecord, ShadowTable
from worker.description.describer import Describer
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, Timed
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.method.positions import is_known
from worker.search.catalogue import MakeIndex
from worker.search.fetcher import Fetcher
from worker.search.ports import Catalogue, Index, SearchableIndex
from worker.service.comparing import FIRST, ComparisonStore, Descriptions, MapComparer
from worker.service.inbox import spread
from worker.service.ports import Comparisons, Listings, Maps, Views
from worker.service.shadow_answers import Outcome, Side, answer, place_of, same_place, search, shows
from worker.service.trouble import STORAGE_ERRORS

log = logging.getLogger("revisit.worker")

PAUSE_S = 2.0
"""Seconds until a comparison that the disk ended is begun again."""


PORTION = 50
"""Views near another that are read together, until one is of its place."""


class ShadowJobs(Protocol):
    """Shadows of maps, and their jobs."""

    def shadow(self, name: str) -> ShadowRecord:
        """The shadow of a map; raises NotFound."""
        ...

    def switch_to_shadow(self, name: str, now: datetime) -> JobRecord:
        """Change a map over to its shadow; raises NotFound, Conflict."""
        ...

    def discard_shadow(self, name: str, now: datetime) -> JobRecord:
        """Discard the shadow of a map; raises NotFound."""
        ...

    def report(self, claim: MapClaim, progress: JobProgress) -> None:
        """Report the progress of a job; raises LeaseLost."""
        ...

    def finish_shadow(self, claim: MapClaim, result: Mapping[str, Any], now: datetime) -> None:
        """End a job as done; raises LeaseLost."""
        ...

    def fail_map_job(self, claim: MapClaim, code: str, detail: str, now: datetime) -> None:
        """End a job as failed; does nothing when the claim is void."""
        ...

    def release_map_job(self, claim: MapClaim) -> None:
        """Put a job back without counting the attempt."""
        ...


class ShadowDescriptions(Descriptions, Protocol):
    """Descriptions by another recipe than the map's."""

    def since(self, name: str, revision: int, recipe: DescriptionRecipe | None = None) -> Changes:
        """All views described by a recipe; raises NotFound."""
        ...

    def described(self, name: str, recipe: str) -> Sequence64:
        """Sequence numbers of the views described by a recipe; raises NotFound."""
        ...


class ShadowComparisons(ComparisonStore, Comparisons, Protocol):
    """Comparisons of views, by another recipe than the map's too."""


class KeptQueries(Protocol):
    """Queries that a map kept."""

    def newest(self, name: str, most: int, *, matched: bool | None = False) -> tuple[list[KeptQuery], int]:
        """The newest `most` queries, oldest first, and how many are kept; `matched` None: of both kinds."""
        ...

    def image(self, name: str, query_id: str) -> bytes:
        """The small image of a kept query, a JPEG; raises NotFound."""
        ...


class ShadowService:
    """The use-cases around shadows, and the work of their jobs.

    Parameters
    ----------
    maps, views, listings, descriptions, comparisons, kept, jobs
        Parts of the store.
    catalogue : Catalogue
    make_index : function
        Description recipe to an empty index.
    comparer : MapComparer
    describers : Describers
    scheduler : Scheduler
    decode : function
        Bytes to Image; raises BadImage.
    calibration : function
        Map to the calibration of its confidences.
    shipped : function
        Recipe to the calibration shipped for it.
    product : Product
        Multiplies dense cells.
    rest : function
        Sleeps for a number of seconds.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        views: Views,
        listings: Listings,
        descriptions: ShadowDescriptions,
        comparisons: ShadowComparisons,
        kept: KeptQueries,
        jobs: ShadowJobs,
        catalogue: Catalogue,
        make_index: MakeIndex,
        comparer: MapComparer,
        describers: Describers,
        scheduler: Scheduler,
        decode: Callable[[bytes], Image],
        calibration: Callable[[MapRecord], Calibration],
        shipped: Callable[[MapRecipe], Calibration],
        product: Product,
        rest: Callable[[float], object] = time.sleep,
    ) -> None:
        self._maps, self._views, self._listings, self._descriptions = maps, views, listings, descriptions
        self._comparisons, self._kept, self._jobs = comparisons, kept, jobs
        self._catalogue, self._make_index, self._comparer = catalogue, make_index, comparer
        self._describers, self._scheduler, self._decode = describers, scheduler, decode
        self._calibration, self._shipped, self._product, self._rest = calibration, shipped, product, rest

    def of(self, name: str) -> ShadowRecord:
        """The shadow of a map; raises NotFound."""
        return self._jobs.shadow(name)

    def switch(self, name: str) -> JobRecord:
        """Change a map over to its shadow; raises NotFound, and Conflict when it is not ready."""
        self._catalogue.prepare(name, self._jobs.shadow(name).recipe.description)
        return self._jobs.switch_to_shadow(name, datetime.now(UTC))

    def discard(self, name: str) -> JobRecord:
        """Discard the shadow of a map, ready or not; raises NotFound."""
        return self._jobs.discard_shadow(name, datetime.now(UTC))

    def run(self, claim: MapClaim, stopping: Callable[[], bool]) -> None:
        """Compare answers until `stopping()` is true; an error fails the job, but the disk's, which is waited for."""
        try:
            while True:
                try:
                    table = self._table(claim, stopping)
                    self._jobs.finish_shadow(claim, table.as_result(), datetime.now(UTC))
                    return
                except STORAGE_ERRORS as error:
                    log.warning("answers cannot be compared for now: %s", error.detail)
                    self._rest(PAUSE_S)
                    _unless(stopping)
        except (JobStopped, EncoderAway):  # the latter only where the service stops while the encoder is away
            self._jobs.release_map_job(claim)
        except LeaseLost:
            log.info("job %s was cancelled, or its map deleted", claim.job_id)
        except RevisitError as error:
            if stopping():
                self._jobs.release_map_job(claim)
            else:
                self._jobs.fail_map_job(claim, error.code, error.detail, datetime.now(UTC))
        except Exception as error:
            log.exception("comparing the answers of the map %s with those of its shadow failed", claim.map)
            self._jobs.fail_map_job(claim, "internal", unforeseen(error), datetime.now(UTC))

    def _table(self, claim: MapClaim, stopping: Callable[[], bool]) -> ShadowTable:
        """The table of a shadow whose views are described."""
        name, shadow = claim.map, self._jobs.shadow(claim.map)
        if shadow.job.id != claim.job_id:
            raise LeaseLost(f"the job {claim.job_id} is no longer that of the shadow of {name}")
        index, record = self._catalogue.index(name)
        recipe, by = shadow.recipe, shadow.recipe.description
        changes = self._descriptions.since(name, 0, by)
        following = self._make_index(by)
        following.apply(changes)
        present = self._descriptions.described(name, record.description.id)
        old_levels = self._comparisons.levels(name)
        self._compare_views(name, following, recipe, changes.seqs, min(old_levels.compared, FIRST), stopping)
        new_levels = self._comparisons.levels(name, by.id)
        old, new = (
            Side(
                which, of, self._fetcher(of, which.description), levels, calibration,
                self._describers.impostors(which.description), self._product, self._describer_of(which),
            )
            for which, of, levels, calibration in (
                (record.recipe, index, old_levels, self._calibration(record)),
                (recipe, following, new_levels, self._shipped(recipe)),
            )
        )  # fmt: skip
        among = np.union1d(present, changes.seqs)  # views enrolled from now on would be found by one alone
        queries = self._queries_of(name, shadow.wanted, old, new, np.intersect1d(present, changes.seqs))
        rows = self._answered(claim, queries, old, new, among, stopping)
        return ShadowTable(
            wanted=shadow.wanted,
            recipe=by.id,
            ranking=recipe.ranking.id,
            old_recipe=record.description.id,
            old_ranking=record.ranking.id,
            old_views=len(present),
            new_views=len(changes.seqs),
            old_compared=old_levels.compared,
            new_compared=new_levels.compared,
            queries=tuple(sorted(rows, key=lambda row: row.agree)),
        )

    def _fetcher(self, index: SearchableIndex, recipe: DescriptionRecipe) -> Fetcher:
        fixed = [self._catalogue.camera_fixed(index, recipe)]
        return Fetcher(self._descriptions, self._comparisons, recipe.id, fixed=fixed)

    def _answered(
        self,
        claim: MapClaim,
        queries: Sequence[KeptQuery | int],
        old: Side,
        new: Side,
        among: Sequence64,
        stopping: Callable[[], bool],
    ) -> list[ShadowQuery]:
        """The queries by both recipes, without those that were removed meanwhile; reports the job's progress."""
        rows = []
        for done, one in enumerate(queries):
            _unless(stopping)
            self._jobs.report(claim, JobProgress(done, len(queries)))
            if isinstance(one, KeptQuery):
                rows.append(self._of_kept(claim.map, one, old, new, among))
            else:
                rows.append(self._of_view(claim.map, one, old, new, among))
        return [row for row in rows if row is not None]

    def _compare_views(
        self,
        name: str,
        index: Index,
        recipe: MapRecipe,
        seqs: Sequence64,
        count: int,
        stopping: Callable[[], bool],
    ) -> None:
        """Compare some views with their map by the new recipe, so that its verdicts know what wrong answers get."""
        missing = count - self._comparisons.levels(name, recipe.description.id).compared
        if missing <= 0 or len(seqs) < 2:
            return
        made = []
        for seq in spread([int(seq) for seq in seqs], count):
            _unless(stopping)
            made += self._comparer.compare([seq], index, recipe, len(seqs))
        self._comparisons.keep(name, recipe, made, datetime.now(UTC))

    def _queries_of(self, name: str, wanted: int, old: Side, new: Side, both: Sequence64) -> list[KeptQuery | int]:
        """The newest kept queries, the last first, and where they are too few views described by both recipes."""
        describable = old.describer is not None and new.describer is not None
        kept = self._kept.newest(name, wanted, matched=None)[0][::-1] if describable else []
        return [*kept, *spread([int(seq) for seq in both], wanted - len(kept))]

    def _describer_of(self, recipe: MapRecipe) -> Describer | None:
        """The describer of a recipe; None where that is of another encoder than the running one."""
        try:
            return self._describers.of(recipe.description)
        except SetupError:
            return None

    def _of_kept(self, name: str, query: KeptQuery, old: Side, new: Side, among: Sequence64) -> ShadowQuery | None:
        """The row of a kept query; None when it was removed meanwhile, or is damaged."""
        try:
            image = self._decode(self._kept.image(name, query.id))
        except (NotFound, BadImage):
            self._maps.get(name)  # which may be what was removed
            return None
        described = [self._describe(image, side.describer) for side in (old, new)]
        found = [
            None if one is None else search(side, one.value, among, None)
            for side, one in zip((old, new), described, strict=True)
        ]
        return self._row(query.id, None, query.queried_at, old, found, described)

    def _describe(self, image: Image, describer: Describer | None) -> Timed[Description] | None:
        """The description of an image, behind all queries; None where nothing of it is static."""
        if describer is None:
            return None
        try:
            return describer.submit(self._scheduler, image, urgent=False).result()
        except NothingStatic:
            return None

    def _of_view(self, name: str, seq: int, old: Side, new: Side, among: Sequence64) -> ShadowQuery | None:
        """The row of a view that queries its own map, itself left out; None when it was deleted meanwhile."""
        view = self._views.at([seq]).get(seq)
        described = [self._descriptions.whole(seq, side.recipe.description) for side in (old, new)]
        if view is None or None in described:
            self._maps.get(name)
            return None
        found = [
            search(side, one, among, seq) for side, one in zip((old, new), described, strict=True) if one is not None
        ]
        return self._row(view.id, view, view.enrolled_at, old, found, [None, None])

    def _row(
        self,
        query_id: str,
        own: ViewRecord | None,
        at: datetime,
        old: Side,
        found: Sequence[Outcome | None],
        described: Sequence[Timed[Description] | None],
    ) -> ShadowQuery:
        within = old.recipe.ranking.same_place_m
        firsts = [None if one is None else one.first for one in found]
        views = self._views.at([seq for seq in firsts if seq is not None])
        known = own is not None and self._is_known(own, within)
        answers = [
            answer(one, timed, views, shows(views.get(first or -1), own, within) if known and own is not None else None)
            for one, first, timed in zip(found, firsts, described, strict=True)
        ]
        return ShadowQuery(
            id=query_id,
            source="kept" if own is None else "view",
            place=None if own is None else own.attributes.place,
            at=at,
            old=answers[0],
            new=answers[1],
            same_place=same_place(firsts[0], firsts[1], old.fetcher.known, within),
        )

    def _is_known(self, view: ViewRecord, within_m: float) -> bool:
        """Whether the map has another view of a view's place, as its user told it."""
        place = place_of(view, within_m)
        only = None if place is None else self._listings.select(view.map, place).only
        others = [] if only is None else [int(seq) for seq in only if seq != view.seq]
        if not is_known(view.attributes.position):
            return bool(others)
        # They lie near on the plane; on another floor is another place. Of a place of thousands few need to be read.
        portions = (others[start : start + PORTION] for start in range(0, len(others), PORTION))
        return any(shows(one, view, within_m) for some in portions for one in self._views.at(some).values())


def _unless(stopping: Callable[[], bool]) -> None:
    if stopping():
        raise JobStopped
