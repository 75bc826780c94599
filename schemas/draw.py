"""An order of views that is random and always the same, to take some of them for all."""

from typing import Any


def draw_order(seq: Any) -> Any:
    """A number from 0 to 2^32 by which views are ordered: Knuth's multiplicative hash (TAOCP 6.4).

    Parameters
    ----------
    seq : int, int64 array or SQL column
        Sequence numbers.

    Returns
    -------
    The same kind.
    """
    return (seq * 2_654_435_761) % 4_294_967_296
