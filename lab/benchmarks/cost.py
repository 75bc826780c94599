"""``./revisit benchmark cost``: memory, disk, cores and money for maps of a size, by the measured figures.

A calculation, no measurement: straight lines through what `docs/sizing.md` has. Prices are arguments, in any currency;
the defaults are round numbers to be replaced by one's own.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

MEMORY_BYTES, ROW_BYTES = 9_600, 69_000
"""Of a view: in each node that serves it, and in the database (speed.md, 100,000 views)."""

DESCRIBE_S, QUERY_S = 0.077, 0.086
"""Seconds of one core: to enrol an image, and to answer a query in a map of at most 100,000 views."""

HOURS = 730
"""Of a month."""


@dataclass(frozen=True)
class Prices:
    """Prices, in one currency.

    Parameters
    ----------
    memory, disk, objects : float
        Of 10^9 bytes for a month: memory of a node, disk of a database, an object store.
    core : float
        Of a core for an hour.
    """

    memory: float = 3.0
    disk: float = 0.1
    objects: float = 0.025
    core: float = 0.04


@dataclass(frozen=True)
class Load:
    """What is served.

    Parameters
    ----------
    views : int
    queries : float
        In a second, at peak; in maps of at most 100,000 views.
    enrolled : float
        Share of the views that is enrolled anew in a month.
    copies : int
        Nodes that hold each map.
    image_bytes : int
    """

    views: int
    queries: float = 10.0
    enrolled: float = 0.05
    copies: int = 2
    image_bytes: int = 200_000


@dataclass(frozen=True)
class Bill:
    """Amounts in 10^9 bytes and cores, and what they cost in a month; `filling`: once, to describe all views."""

    memory: float
    database: float
    images: float
    cores: float
    month: dict[str, float]
    filling: float


def bill(load: Load, prices: Prices) -> Bill:
    """What a load costs.

    The database has room for itself twice, as an upgrade needs it. Cores answer all queries at peak with as much again
    to spare, and at least two a copy; describing is spread over the month.
    """
    memory = load.copies * load.views * MEMORY_BYTES / 1e9
    database = 2 * load.views * ROW_BYTES / 1e9
    images = load.views * load.image_bytes / 1e9
    answering = max(2.0 * load.copies, 2 * load.queries * QUERY_S)
    describing = load.enrolled * load.views * DESCRIBE_S / 3600 / HOURS
    month = {
        "memory": memory * prices.memory,
        "database": database * prices.disk,
        "images": images * prices.objects,
        "cores": (answering + describing) * HOURS * prices.core,
    }
    filling = load.views * DESCRIBE_S / 3600 * prices.core
    return Bill(memory, database, images, answering + describing, month, filling)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, a column for each number of views."""
    parser = argparse.ArgumentParser(prog="revisit benchmark cost", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--views", type=int, nargs="+", default=[100_000, 10_000_000, 1_000_000_000])
    parser.add_argument("--queries", type=float, nargs="+", default=[10, 10, 1000], help="a second, for each of them")
    for name, default in vars(Prices()).items():
        parser.add_argument(f"--{name}", type=float, default=default, help=f"price (default: {default})")
    parser.add_argument("--copies", type=int, default=2, help="nodes that hold each map (default: 2)")
    parser.add_argument("--image-kb", type=float, default=200, help="10^3 bytes of an image (default: 200)")
    parser.add_argument("--enrolled", type=float, default=0.05, help="share enrolled anew in a month (default: 0.05)")
    given = parser.parse_args(arguments)
    if len(given.queries) != len(given.views):
        parser.error("--queries needs a number for each of --views")
    prices = Prices(given.memory, given.disk, given.objects, given.core)
    image_bytes = round(given.image_kb * 1000)
    bills = [
        bill(Load(views, queries, given.enrolled, given.copies, image_bytes), prices)
        for views, queries in zip(given.views, given.queries, strict=True)
    ]
    rows = [("views", [f"{views:,}" for views in given.views]), ("queries a second", [f"{q:g}" for q in given.queries])]
    rows += [
        ("memory of all nodes, GB", [f"{one.memory:,.1f}" for one in bills]),
        ("disk of the database, GB", [f"{one.database:,.1f}" for one in bills]),
        ("images, GB", [f"{one.images:,.1f}" for one in bills]),
        ("cores", [f"{one.cores:,.1f}" for one in bills]),
    ]
    rows += [(f"{part}, a month", [f"{one.month[part]:,.0f}" for one in bills]) for part in bills[0].month]
    rows.append(("all of it, a month", [f"{sum(one.month.values()):,.0f}" for one in bills]))
    rows.append(("describing all, once", [f"{one.filling:,.0f}" for one in bills]))
    for name, cells in rows:
        print(f"{name:26}" + "".join(f"{cell:>18}" for cell in cells))
