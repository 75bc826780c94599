"""``revisit encode``: an encoder that several nodes share."""

import argparse
import socket
from typing import TYPE_CHECKING

from app.cli import logs
from app.cli.listening import address, is_loopback, listen, serve_until_stopped
from app.cli.options import Verbs, integer
from app.cli.output import Failure, show
from app.cli.processor import check_processor
from app.cli.serve import settings_of
from app.cli.starting import collecting_nothing

if TYPE_CHECKING:
    from schemas.settings import Settings


def add(verbs: Verbs) -> None:
    """Declare the command."""
    encode = verbs.add_parser(
        "encode",
        help="encode images for services and workers that have no GPU",
        description="Encode images for services and workers whose REVISIT_ENCODER_URL names this process, all of them "
        "together in batches. It keeps nothing. Flags win over REVISIT_* variables.",
    )
    encode.add_argument("--host", help="address to listen on (default: 127.0.0.1)")
    encode.add_argument("--port", type=integer, help="port to listen on; 0 picks a free one (default: 8000)")
    encode.add_argument(
        "--open",
        action="store_const",
        const=True,
        help="allow an address that others can reach, although anybody may then have images encoded",
    )
    encode.add_argument("--encoder", choices=("compact", "compact-open"), help="network (default: compact)")
    encode.add_argument("--device", help="where the network runs: cpu, cuda, ... (default: cpu)")
    encode.add_argument("--threads", type=integer, help="of the network (default: one for each core that may be used)")
    encode.set_defaults(run=run_encode)


def run_encode(arguments: argparse.Namespace) -> int:
    """Encode until SIGINT or SIGTERM."""
    check_processor()
    settings = settings_of(arguments, "host", "port", "open", "encoder", "device", "threads")
    if not (is_loopback(settings.host) or settings.open or settings.encoder_key):
        raise Failure(
            f"{settings.host} can be reached by others, and there is no key: anybody could keep the encoder busy.\n"
            "Set REVISIT_ENCODER_KEY here and at the nodes, listen on 127.0.0.1, or say --open if the\n"
            "network is yours.",
            2,
        )
    logs.configure(settings.log, settings.log_level)
    listening = listen(settings)
    try:
        with collecting_nothing():
            return _encode(settings, listening)
    finally:
        listening.close()


def _encode(settings: "Settings", listening: socket.socket) -> int:
    from app.http.encoding import encoder_application
    from worker.configure import configure
    from worker.encoders.choosing import batch_of, make_encoder_to_share
    from worker.encoders.cores import usable_cores
    from worker.service.encoding import EncodingService

    threads = settings.threads or usable_cores()
    configure(threads)
    encoder, segmenter = make_encoder_to_share(settings, threads)
    app = encoder_application(
        lambda observe: EncodingService(encoder, batch_of(settings), observe, segmenter=segmenter), settings
    )
    shared = app.state.shared
    url = address(settings.host, listening.getsockname()[1])
    return serve_until_stopped(
        app,
        settings,
        listening,
        "encoder",
        drain=shared.drain,
        announce=lambda: show(
            f"revisit encodes at {url}\n"
            f"  encoder   {shared.service.model} on {settings.device}\n"
            f"  segmenter {shared.service.segmenting_model or 'none'}\n"
            f"  nodes     REVISIT_ENCODER_URL={url}"
        ),
        beyond_help=shared.beyond_help,
    )
