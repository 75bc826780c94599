"""The console: its page at `/`, and under `/console/` what the page loads. It calls the routes that everybody calls."""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from app.console.files import POLICY, files
from app.http.conditional import is_fresh
from app.http.dependencies import checked, no_parameters

router = APIRouter(tags=["service"], dependencies=[*checked, no_parameters])


async def console(request: Request) -> Response:
    """A file of the console. It needs no key: what it shows comes from routes that ask for one."""
    file = files()[request.scope["route"].path]
    # Browsers keep it and ask each time whether it is current: after an upgrade no two versions are mixed.
    headers = {"ETag": file.etag, "Cache-Control": "no-cache", "Content-Security-Policy": POLICY}
    if is_fresh(request, file.etag):
        return Response(status_code=304, headers=headers)
    return Response(file.data, headers=headers, media_type=file.media_type)


for _path in files():
    router.add_api_route(_path, console, methods=["GET", "HEAD"], include_in_schema=False)
