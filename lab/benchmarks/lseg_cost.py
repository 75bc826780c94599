"""How much arithmetic the image network takes: the bound on its speed."""

from collections.abc import Mapping

from worker.encoders.lseg.config import Config
from worker.encoders.lseg.decoder import HALO, Cells
from worker.encoders.lseg.enlarge import Axis


def multiply_adds(config: Config, size: Cells, keep: Cells | None = None) -> Mapping[str, int]:
    """Multiply-adds of one pass, by part; two floating-point operations each.

    Parameters
    ----------
    config : Config
    size : (int, int)
        (height, width) of the network's input.
    keep : (int, int) or None
        As for `Network.forward`.

    Returns
    -------
    mapping of part to int
        Products of matrices and convolutions as this implementation does them. Norms, activations, enlargements and
        the softmax are left out: together they are below one in a hundred.
    """
    rows, columns = size[0] // config.patch, size[1] // config.patch
    return {
        "transformer": _transformer(config, rows * columns),
        "reassembly": _reassembly(config, rows, columns),
        "decoder": _decoder(config, rows, columns, keep),
    }


def _transformer(config: Config, patches: int) -> int:
    """Patch embedding and blocks up to the last tap."""
    tokens, width = patches + 1, config.width
    embedding = patches * 3 * config.patch**2 * width
    dense = tokens * (4 * width * width + 2 * width * config.hidden)
    attention = 2 * tokens**2 * width
    return embedding + (max(config.taps) + 1) * (dense + attention)


def _reassembly(config: Config, rows: int, columns: int) -> int:
    """Readouts, 1x1 convolutions, and the resampling of taps 1, 2 and 4."""
    patches, width = rows * columns, config.width
    first, second, _, fourth = config.tap_channels
    readouts = len(config.taps) * (patches + 1) * width * width
    narrow = sum(patches * width * channels for channels in config.tap_channels)
    resample = patches * (16 * first**2 + 4 * second**2) + _halved(rows) * _halved(columns) * 9 * fourth**2
    return readouts + narrow + resample


def _decoder(config: Config, rows: int, columns: int, keep: Cells | None) -> int:
    """Four steps and the head."""
    kept = keep or (8 * rows, 8 * columns)
    near = (
        min(Axis(4 * side, 8 * side, 0, wanted).reach + HALO, 4 * side)
        for side, wanted in zip((rows, columns), kept, strict=True)
    )
    cells = [
        next(near) * next(near),
        4 * rows * columns,
        rows * columns,
        _halved(rows) * _halved(columns),
    ]
    features = config.features
    entry = sum(n * 9 * channels * features for n, channels in zip(cells, config.tap_channels, strict=True))
    unit = 2 * 9 * features**2
    steps = sum(n * (2 * unit + features**2) for n in cells) - cells[3] * unit
    return entry + steps + kept[0] * kept[1] * features * config.channels


def _halved(side: int) -> int:
    """A side after a 3x3 convolution of stride 2 with padding 1."""
    return (side + 1) // 2
