"""`/maps/{map}/proposals`: queries that would refresh places, listed, taken as views, dismissed."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response

from app.http.body import json_object
from app.http.dependencies import Curates, MapName, checked, no_parameters
from app.http.openapi import answers_bytes, refusals, takes_json
from app.http.parameters import ProposalParameters
from app.http.validation import validated
from schemas.requests import PostProposal
from schemas.wire import DismissedPlace, NamedPlace, Proposals

router = APIRouter(tags=["maps"], dependencies=checked)

ProposalId = Annotated[str, Path(description="Id of the proposal, from the list.")]


@router.get("/maps/{map}/proposals", response_model=Proposals, responses=refusals("not-found"))
async def list_proposals(name: MapName, params: Annotated[ProposalParameters, Query()], curator: Curates) -> Proposals:
    """Queries that matched a place although they look unlike its views; kept where `keep_matches` is above 0."""
    return await curator.proposals(name, params.limit)


@router.get(
    "/maps/{map}/proposals/{proposal_id}/image",
    response_class=Response,
    dependencies=[no_parameters],
    responses={**answers_bytes("image/jpeg", description="The image, small and upright."), **refusals("not-found")},
)
async def proposal_image(
    name: MapName,
    proposal_id: Annotated[str, Path(description="Id of a proposal, or of any of its queries.")],
    curator: Curates,
) -> Response:
    """A small image of a query that matched a place although it looks unlike its views."""
    return Response(await curator.kept_image(name, proposal_id), media_type="image/jpeg")


@router.post(
    "/maps/{map}/proposals/{proposal_id}",
    response_model=NamedPlace,
    dependencies=[no_parameters],
    openapi_extra=takes_json({"$ref": "#/components/schemas/PostProposal"}, required=True, example={"views": 2}),
    responses=refusals("malformed-body", "not-found", "conflict", "body-too-large", "disk-full", "too-many-requests"),
)
async def accept_proposal(name: MapName, proposal_id: ProposalId, request: Request, curator: Curates) -> NamedPlace:
    """Enrol images of a proposal as views of the place that they matched, with `proposed_by` in their metadata."""
    wanted = validated(PostProposal, await json_object(request), strict=True)
    return await curator.accept_proposal(name, proposal_id, wanted.views, wanted.unconfirmed)


@router.delete(
    "/maps/{map}/proposals/{proposal_id}",
    response_model=DismissedPlace,
    dependencies=[no_parameters],
    responses=refusals("not-found"),
)
async def dismiss_proposal(name: MapName, proposal_id: ProposalId, curator: Curates) -> DismissedPlace:
    """Delete the queries of a proposal, and their images."""
    return await curator.dismiss_proposal(name, proposal_id)
