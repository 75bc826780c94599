"""The use-cases of a service, each built of the parts that it needs."""

from dataclasses import dataclass
from functools import partial

from schemas.recipe import MapRecipe
from worker.images import codec, quality
from worker.runtime.parts import Parts
from worker.search.fixed_cells import FixedCells
from worker.service.ageing import AgeingPlaces
from worker.service.attendance import Attendance
from worker.service.calibrating import CalibrationService
from worker.service.calibrations import calibration_of, shipped_calibration
from worker.service.changes import ChangeService
from worker.service.day_scores import ScoreKeeper
from worker.service.drives import Drives
from worker.service.enroll import EnrollService
from worker.service.explanations import Explanations
from worker.service.health import HealthService
from worker.service.import_receiving import ImportService
from worker.service.inbox import InboxService
from worker.service.jobs import JobService
from worker.service.keeping import QueryKeeper
from worker.service.keys import KeyService
from worker.service.maps import MapService
from worker.service.proposals import ProposalService
from worker.service.query import QueryService
from worker.service.recordings import Limits
from worker.service.renderings import RenderingService
from worker.service.resemblances import Resemblances
from worker.service.searching import Searcher
from worker.service.shadows import ShadowService
from worker.service.snapshots import SnapshotService
from worker.service.views import ViewService


@dataclass(frozen=True)
class Services:
    """The use-cases."""

    enroll: EnrollService
    query: QueryService
    searcher: Searcher
    views: ViewService
    renderings: RenderingService
    changes: ChangeService
    maps: MapService
    jobs: JobService
    calibration: CalibrationService
    health: HealthService
    inbox: InboxService
    proposals: ProposalService
    keys: KeyService
    snapshots: SnapshotService
    shadows: ShadowService
    imports: ImportService


def make_services(parts: Parts, attendance: Attendance, default_recipe: MapRecipe) -> Services:
    """Build the use-cases.

    Parameters
    ----------
    parts : Parts
    attendance : Attendance
        Says how many workers describe images, so that a caller learns how long its image will wait.
    default_recipe : MapRecipe
        Recipe of a map that its first enrolment creates.
    """
    settings, store, decoder = parts.settings, parts.store, parts.decoder
    scheduler, describers, catalogue = parts.scheduler, parts.describers, parts.catalogue
    explanations = Explanations(settings.explanations)
    searcher = Searcher(
        maps=store.maps,
        views=store.views,
        listings=parts.selecting,
        descriptions=store.descriptions,
        comparisons=store.comparisons,
        queue=store.jobs,
        describers=describers,
        scheduler=scheduler,
        catalogue=catalogue,
        calibration=calibration_of,
        product=parts.product,
    )
    enroll = EnrollService(
        maps=store.maps, enrolment=parts.enrolment, views=store.views, removals=store.removals, queue=store.jobs,
        settlements=parts.settlements, read_exif=decoder.read_exif,
        room=parts.enrolment_room,
        look_for_problem=quality.problem_of, default_recipe=default_recipe, limit=settings.queue,
        pace_s=lambda: scheduler.pace_s, wake=parts.bell.ring, workers=attendance,
        describer=searcher.describer,
        resembles=Resemblances(store.maps, store.descriptions, searcher, parts.duplicates).of,
    )  # fmt: skip
    stored = partial(decoder.decode, stored=True)
    renderings = RenderingService(
        maps=store.maps, views=store.views, descriptions=store.descriptions, describers=describers,
        scheduler=scheduler, segmenting=parts.segmenting, decode=stored, thumbnail=decoder.thumbnail,
        explanations=explanations,
    )  # fmt: skip
    changes = ChangeService(
        maps=store.maps, views=store.views, describers=describers, scheduler=scheduler, segmenting=parts.segmenting,
        decode=stored, explanations=explanations,
    )  # fmt: skip
    scores = ScoreKeeper(store.day_scores)
    proposals = ProposalService(maps=store.maps, views=store.views, kept=store.kept_queries, enroll=enroll)
    health = HealthService(
        maps=store.maps, comparisons=store.comparisons, descriptions=store.descriptions, calibration=calibration_of,
        camera_fixed=FixedCells(store.descriptions).among,
        ageing=AgeingPlaces(store.day_scores, store.views, proposals.of, scores.write),
    )  # fmt: skip
    calibration = CalibrationService(
        maps=store.maps, views=store.views, listings=store.listings, descriptions=store.descriptions,
        comparisons=store.comparisons, catalogue=catalogue, describers=describers, shipped=shipped_calibration,
        product=parts.product,
    )  # fmt: skip
    imports = ImportService(
        uploads=store.uploads, jobs=store.jobs, limits=Limits.of(settings), default_recipe=default_recipe,
        refuses_poor=store.maps.refuses_poor, wake=parts.bell.ring_all, describer=searcher.describer,
    )  # fmt: skip
    return Services(
        enroll=enroll,
        inbox=InboxService(maps=store.maps, kept=store.kept_queries, enroll=enroll),
        proposals=proposals,
        query=QueryService(
            searcher=searcher,
            views=store.views,
            descriptions=store.descriptions,
            room=parts.query_room,
            shrink=codec.shrink,
            look_for_problem=quality.problem_of,
            is_blank=quality.is_blank,
            thumbnail=decoder.thumbnail,
            kept=QueryKeeper(store.kept_queries, store.maps, parts.blurring, scheduler, describers, decoder.decode),
            scores=scores,
            explanations=explanations,
            drives=Drives(searcher.further),
        ),
        searcher=searcher,
        views=ViewService(maps=store.maps, views=store.views, removals=store.removals, listings=store.listings),
        renderings=renderings,
        changes=changes,
        maps=MapService(
            maps=store.maps,
            removals=store.removals,
            jobs=store.jobs,
            uploads=store.uploads,
            comparisons=store.comparisons,
            shipped=shipped_calibration,
            encoder=parts.encoder,
            describers=describers,
            catalogue=catalogue,
            preset=settings.preset,
            blurring=parts.blurring,
            wake=parts.bell.ring_all,
        ),
        jobs=JobService(store.jobs, store.uploads),
        keys=KeyService(store.keys),
        health=health,
        snapshots=parts.snapshots,
        shadows=parts.shadows,
        imports=imports,
        calibration=calibration,
    )  # fmt: skip
