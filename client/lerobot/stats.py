"""Statistics of each episode and of the dataset, with which policies normalise their inputs."""

import io
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError

Array = NDArray[np.float64]
Statistics = Mapping[str, NDArray[Any]]
"""min, max, mean, std, count and quantiles of one feature."""

_QUANTILES: Final = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
_SHADES: Final = 256
_ROUNDED: Final = 1e-12
# how many images of an episode are sampled, and which of their pixels: the same as in LeRobot
_MIN_SAMPLES, _MAX_SAMPLES, _POWER = 100, 10_000, 0.75
_LARGE, _SMALL = 300, 150


def number_statistics(values: Array) -> Statistics:
    """Statistics of a feature's numbers over an episode (n, k)."""
    names, shares = list(_QUANTILES), list(_QUANTILES.values())
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(names, np.quantile(values, shares, axis=0), strict=True)),
    }


def picture_statistics(pictures: Sequence[bytes]) -> Statistics:
    """Statistics of the colours of an episode's images, 0 to 1, each (3, 1, 1).

    Raises RecordingError for data that is not JPEG, and for images of different sizes.
    """
    count = min(len(pictures), max(_MIN_SAMPLES, min(int(len(pictures) ** _POWER), _MAX_SAMPLES)))
    places = np.round(np.linspace(0, len(pictures) - 1, count)).astype(int)
    shades, sizes = np.zeros((3, _SHADES)), set()
    for place in places.tolist():
        picture = decoded(pictures[place])
        sizes.add(picture.shape)
        for colour, counted in enumerate(shades):
            counted += np.bincount(_downsampled(picture)[..., colour].ravel(), minlength=_SHADES)
    if len(sizes) > 1:
        raise RecordingError(f"the images of one camera have {len(sizes)} different sizes")
    return {name: values.reshape(3, 1, 1) for name, values in _shade_statistics(shades).items()} | {
        "count": np.array([count])
    }


def _shade_statistics(counts: Array) -> dict[str, Array]:
    """Statistics from the number of occurrences of each shade, (colours, shades)."""
    values, shares = np.arange(_SHADES) / (_SHADES - 1), counts / counts.sum(axis=1, keepdims=True)
    mean, below = shares @ values, np.cumsum(shares, axis=1)
    return {
        "min": values[np.argmax(counts > 0, axis=1)],
        "max": values[_SHADES - 1 - np.argmax(counts[:, ::-1] > 0, axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(shares @ values**2 - mean**2, 0.0)),
        **{name: values[np.argmax(below >= share - _ROUNDED, axis=1)] for name, share in _QUANTILES.items()},
    }


def decoded(jpeg: bytes) -> NDArray[np.uint8]:
    """Decode an image (height, width, 3). Raises RecordingError if it is not a readable JPEG."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(jpeg), formats=["JPEG"]) as picture:
            return np.asarray(picture.convert("RGB"))
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
        raise RecordingError(f"an image in it is not a readable JPEG: {error}") from error


def _downsampled(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    if max(width, height) < _LARGE:
        return picture
    step = max(width, height) // _SMALL
    return picture[::step, ::step]


def combined(parts: Sequence[Statistics]) -> Statistics:
    """Combine the statistics of several episodes. Quantiles are averaged, which is an approximation, as in LeRobot."""
    counts = np.array([part["count"][0] for part in parts], np.float64)
    shares = counts / counts.sum()

    def mean(name: str, values: Sequence[Array]) -> Array:
        return np.tensordot(shares, np.stack(values), 1)

    middle = mean("mean", [part["mean"] for part in parts])
    spread = mean("std", [part["std"] ** 2 + (part["mean"] - middle) ** 2 for part in parts])
    return {
        "min": np.min([part["min"] for part in parts], axis=0),
        "max": np.max([part["max"] for part in parts], axis=0),
        "mean": middle,
        "std": np.sqrt(spread),
        "count": np.array([int(counts.sum())]),
        **{name: mean(name, [part[name] for part in parts]) for name in _QUANTILES},
    }
