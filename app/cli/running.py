"""``revisit healthcheck | version | openapi``: readiness, versions and API of a service."""

import argparse

from app.cli.listening import url_of_environment
from app.cli.options import Verbs, add_service_options, service_of
from app.cli.output import DONE, FAILED, say, show, show_json, table


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    check = verbs.add_parser("healthcheck", help="exit 0 when the service is ready, 1 when not")
    add_service_options(check)
    check.set_defaults(run=run_healthcheck)
    version = verbs.add_parser("version", help="the installed version; with --service, that of the running service")
    version.add_argument("--service", action="store_true", help="query the running service")
    add_service_options(version)
    version.set_defaults(run=run_version)
    openapi = verbs.add_parser("openapi", help="the OpenAPI document of the running service")
    add_service_options(openapi)
    openapi.set_defaults(run=run_openapi)


def run_healthcheck(arguments: argparse.Namespace) -> int:
    """Call `/readyz`, by default where `serve` listens by REVISIT_HOST and REVISIT_PORT, as a container's health check
    and a unit of systemd need."""
    from revisit_client import Revisit

    url = arguments.url or url_of_environment()
    with Revisit(url, key=arguments.key, timeout=5, patience=0) as revisit:
        readiness = revisit.readyz()
    if arguments.json:
        show_json(readiness)
    elif readiness.ready:
        show("ready")
    else:
        for part, state in readiness.checks.items():
            say(f"{part}: {state}")
    return DONE if readiness.ready else FAILED


def run_version(arguments: argparse.Namespace) -> int:
    """Print versions."""
    from app.version import VERSION

    if not arguments.service:
        if arguments.json:
            show_json({"version": VERSION})
        else:
            show(f"revisit {VERSION}")
        return DONE

    with service_of(arguments) as revisit:
        facts = revisit.version().model_dump(mode="json")
    if arguments.json:
        show_json(facts)
    else:
        libraries = facts.pop("libraries")
        show(table(("what", "version"), [*facts.items(), *libraries.items()]))
    return DONE


def run_openapi(arguments: argparse.Namespace) -> int:
    """Print the OpenAPI document."""

    with service_of(arguments) as revisit:
        show_json(revisit.openapi())
    return DONE
