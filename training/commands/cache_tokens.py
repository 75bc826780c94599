"""Tokens of a teacher on crops of every training image: ``python -m training.commands.cache_tokens``.

They are computed once (0.1 s a crop and core), one file an image; a run that was stopped goes on.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from lab.baselines.dinov2 import SIZE, DinoV2
from training.data.crops import crops_of, images_to_distil, token_file
from training.data.images import read_rgb


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.cache_tokens", description="Cache a teacher's tokens of all training images."
    )
    parser.add_argument("--teacher", type=Path, required=True, help="ONNX file of DINOv2 ViT-S/14, 224 x 224")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--to", type=Path, required=True, help="folder of the cache; 4 GB")
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), metavar=("I", "N"), help="the I-th of N processes")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    options.to.mkdir(parents=True, exist_ok=True)
    teacher = DinoV2(options.teacher)
    part, parts = options.part
    for path in images_to_distil(options.data)[part::parts]:
        target = token_file(path, options.data, options.to)
        if target.exists():
            continue
        image = read_rgb(path)
        crops = crops_of(path, options.data, image.shape[:2])
        tokens = np.stack([teacher.tokens(crop.cut(image, SIZE)) for crop in crops])
        partial = target.with_suffix(".partial.npy")
        np.save(partial, tokens)
        partial.replace(target)


if __name__ == "__main__":
    main()
