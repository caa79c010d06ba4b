"""The random numbers of one robot: a stream for each purpose, so that none depends on how often another was asked.

All follow from the robot's seed: the same seed, the same run. They are part of the state that is saved.
"""

import struct
from base64 import b64decode, b64encode
from collections.abc import Mapping
from random import Random
from typing import Any, Final

_STATE: Final = struct.Struct("<625I")  # of the Mersenne Twister


class Chances:
    """Streams of random numbers by name, which `restart` and `restore` change in place."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._streams: dict[str, Random] = {}

    def stream(self, name: str) -> Random:
        """The stream of this name, from its beginning when it is asked for first."""
        if name not in self._streams:
            self._streams[name] = Random(f"{name} {self._seed}")
        return self._streams[name]

    def restart(self, seed: int) -> None:
        """Begin every stream again, from another seed."""
        self._seed = seed
        for name, stream in self._streams.items():
            stream.seed(f"{name} {seed}")

    def begun(self, seed: int) -> dict[str, Any]:
        """The state of all streams after `restart`, for `restore`."""
        return {name: _saved(Random(f"{name} {seed}")) for name in self._streams}

    def save(self) -> dict[str, Any]:
        """The state of all streams, for `restore`."""
        return {name: _saved(stream) for name, stream in self._streams.items()}

    def restore(self, states: Mapping[str, Any]) -> None:
        """Continue every stream from its saved state. Raises ValueError, TypeError and KeyError for other values."""
        known = {name: _loaded(states[name]) for name in self._streams}
        for name, state in known.items():
            self._streams[name].setstate(state)


def _saved(stream: Random) -> list[Any]:
    version, numbers, gauss = stream.getstate()
    return [version, b64encode(_STATE.pack(*numbers)).decode(), gauss]


def _loaded(state: Any) -> tuple[Any, ...]:
    version, numbers, gauss = state
    try:
        return version, _STATE.unpack(b64decode(numbers)), gauss
    except struct.error as error:
        raise ValueError(f"the state of a random stream is damaged: {error}") from error
