"""Fit the projection of RootSIFT descriptors that ships with the program.

    python -m training.commands.fit_rootsift_projection FOLDER [FOLDER ...] [--to FILE]

The folders hold images of many places and kinds (streets, rooms), none of a set that place recognition is judged on.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from schemas.description import Floats
from worker.description.local_features import PROJECTION, root_descriptors

SUFFIXES = (".jpg", ".jpeg", ".png")
KEYPOINTS = 300
DIMENSIONS = 48


def principal_components(descriptors: Floats, dimensions: int) -> tuple[Floats, Floats]:
    """Mean and principal components of descriptors.

    Parameters
    ----------
    descriptors : float32 of shape (n, channels)
    dimensions : int
        At most `channels`.

    Returns
    -------
    mean : float32 of shape (channels,)
    matrix : float32 of shape (channels, dimensions)
        Orthonormal columns, the component of largest variance first. The entry of largest magnitude in each is
        positive, so that the same images give the same signs on every machine.
    """
    mean = descriptors.mean(axis=0, dtype=np.float64)
    _, vectors = np.linalg.eigh(np.cov(descriptors.T.astype(np.float64)))
    matrix = vectors[:, ::-1][:, :dimensions]
    matrix = matrix * np.sign(matrix[np.abs(matrix).argmax(axis=0), np.arange(dimensions)])
    return mean.astype(np.float32), matrix.astype(np.float32)


def main(arguments: Sequence[str] | None = None) -> None:
    """Read images, write the projection."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.fit_rootsift_projection", description="Fit the projection of RootSIFT."
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--to", type=Path, default=PROJECTION)
    parser.add_argument("--images", type=int, default=700, help="drawn at random when there are more")
    options = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    paths = sorted(p for folder in options.folders for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES)
    drawn = np.random.default_rng(0).permutation(len(paths))[: options.images]
    images = (cv2.imread(str(paths[i]), cv2.IMREAD_COLOR_RGB) for i in sorted(drawn))
    found = [root_descriptors(pixels, KEYPOINTS)[1] for pixels in images if pixels is not None]
    mean, matrix = principal_components(np.concatenate(found), DIMENSIONS)
    np.savez_compressed(options.to, mean=mean.astype(np.float16), matrix=matrix.astype(np.float16))
    print(f"{sum(map(len, found))} descriptors of {len(found)} images -> {options.to}")


if __name__ == "__main__":
    main()
