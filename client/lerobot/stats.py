"""Statistics of a dataset, which policies normalise what they see by: of each episode, and of all together."""

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
_PIXELS: Final = 255.0
# how many pictures of an episode count, and which of their pixels: as LeRobot's own statistics take them
_FEWEST, _MOST, _POWER = 100, 10_000, 0.75
_LARGE, _SMALL = 300, 150


def of_numbers(values: Array) -> Statistics:
    """Of a feature's numbers over an episode (n, k)."""
    names, shares = list(_QUANTILES), list(_QUANTILES.values())
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **dict(zip(names, np.quantile(values, shares, axis=0), strict=True)),
    }


def of_pictures(pictures: Sequence[bytes]) -> Statistics:
    """Of the colours of an episode's pictures, 0 to 1, each (3, 1, 1). Raises RecordingError for what is not a JPEG."""
    count = min(len(pictures), max(_FEWEST, min(int(len(pictures) ** _POWER), _MOST)))
    places = np.round(np.linspace(0, len(pictures) - 1, count)).astype(int)
    pixels = np.concatenate([_fewer(decoded(pictures[place])).reshape(-1, 3) for place in places.tolist()])
    found = {name: values.reshape(-1, 1, 1) / _PIXELS for name, values in of_numbers(pixels).items() if name != "count"}
    return found | {"count": np.array([count])}


def decoded(jpeg: bytes) -> NDArray[np.uint8]:
    """A picture (height, width, 3). Raises RecordingError for what is not a JPEG."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(jpeg), formats=["JPEG"]) as picture:
            return np.asarray(picture.convert("RGB"))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError) as error:
        raise RecordingError(f"a picture of it is not a JPEG that can be read: {error}") from error


def _fewer(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = picture.shape[:2]
    if max(width, height) < _LARGE:
        return picture
    step = max(width, height) // _SMALL
    return picture[::step, ::step]


def together(parts: Sequence[Statistics]) -> Statistics:
    """Of several episodes. Quantiles are means of the episodes': an approximation, as in LeRobot."""
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
