"""PolyScope versions, the two controller series, and the versions that have a feature.

The major version identifies the series: CB3 is 3.x, and e-Series is 5.x or 10.x, which is PolyScope X on the same arms.
A feature therefore has a first version for each of the three software lines; ``None`` means that the line never got it.
"""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

from urproto.compat import Self

_POLYSCOPE_X: Final = 10


class Series(Enum):
    """Controller generation. The control period depends only on the series."""

    CB3 = "CB3"
    E = "e-Series"

    @property
    def period_s(self) -> float:
        """Control period [s]: 8 ms on CB3, 2 ms on e-Series (Script Manual, get_steptime)."""
        return 0.008 if self is Series.CB3 else 0.002

    @property
    def frequency_hz(self) -> int:
        """Control frequency [Hz]."""
        return 125 if self is Series.CB3 else 500


@dataclass(frozen=True, order=True, slots=True)
class PolyscopeVersion:
    """A PolyScope version such as 3.15.8.106339 (major, minor, bugfix, build)."""

    major: int
    minor: int
    bugfix: int = 0
    build: int = 0

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse ``"5.12"``, ``"3.15.8"`` or ``"3.15.8.106339"``.

        Raises ValueError when the text does not have this form.
        """
        if not re.fullmatch(r"[0-9]{1,9}\.[0-9]{1,9}(\.[0-9]{1,9}){0,2}", text.strip()):
            raise ValueError(
                f"{text!r} is not a PolyScope version: use major.minor[.bugfix[.build]], for example 3.15.8"
            )
        return cls(*(int(part) for part in text.strip().split(".")))

    @property
    def series(self) -> Series:
        """CB3 for 3.x, e-Series for everything newer."""
        return Series.CB3 if self.major < 5 else Series.E

    @property
    def is_polyscope_x(self) -> bool:
        """True for 10.x, which has the Robot API and another program format."""
        return self.major >= _POLYSCOPE_X

    @property
    def short(self) -> str:
        """The version without the build number: 3.15.8."""
        return f"{self.major}.{self.minor}.{self.bugfix}"

    def __str__(self) -> str:
        """The version as controllers write it: before 3.3 the third number is the build, as in 3.2.18654."""
        return f"{self.short}.{self.build}" if self.build else self.short


_FIRST_X: Final = PolyscopeVersion(10, 0)

DEFAULT_VERSION = {
    Series.CB3: PolyscopeVersion(3, 15, 8),
    Series.E: PolyscopeVersion(5, 22),  # the minor version that clients need
}


# The 10.x that corresponds to a 5.x, for features without a documented 10.x. Known pairs: optimovej (5.21, 10.8), UR15
# (5.22, 10.8), UR7e (5.22, 10.9), UR8 Long (5.23, 10.11), the energies of RTDE (5.23, 10.11), friction scales (5.25.1,
# 10.12.1). It is a guess that other features of the same 5.x came in the same 10.x, and that 10.0 has all of 5.19.
_COUNTERPARTS: Final = (
    (PolyscopeVersion(5, 20), _FIRST_X),
    (PolyscopeVersion(5, 21), PolyscopeVersion(10, 7)),
    (PolyscopeVersion(5, 22), PolyscopeVersion(10, 8)),
    (PolyscopeVersion(5, 23), PolyscopeVersion(10, 9)),
    (PolyscopeVersion(5, 25), PolyscopeVersion(10, 11)),
    (PolyscopeVersion(5, 26), PolyscopeVersion(10, 12)),
)
_NEWEST: Final = PolyscopeVersion(10, 13)


def _counterpart(first: PolyscopeVersion) -> PolyscopeVersion:
    """The first 10.x with the features of a 5.x."""
    return next((x for until, x in _COUNTERPARTS if first < until), _NEWEST)


@dataclass(frozen=True, slots=True)
class Availability:
    """The first version with a feature in each software line; None if the line never got it."""

    cb3: PolyscopeVersion | None
    e: PolyscopeVersion | None
    x: PolyscopeVersion | None

    @classmethod
    def since(cls, cb3: str | None, e: str | None, x: str | None = "") -> Self:
        """Create from version texts, ``None`` for a line without the feature.

        x: the 10.x; by default the one that corresponds to the 5.x.
        """
        on_cb3, on_e, on_x = (PolyscopeVersion.parse(text) if text else None for text in (cb3, e, x))
        return cls(on_cb3, on_e, _counterpart(on_e) if x == "" and on_e else on_x)

    def first(self, version: PolyscopeVersion) -> PolyscopeVersion | None:
        """The first version with the feature in the software line of a version."""
        if version.is_polyscope_x:
            return self.x
        return self.cb3 if version.series is Series.CB3 else self.e

    def covers(self, version: PolyscopeVersion) -> bool:
        """True when a controller of this version has the feature."""
        first = self.first(version)
        return first is not None and version >= first

    def __str__(self) -> str:
        """Readable text: ``CB3 since 3.12, e-Series since 5.6``, or ``e-Series since 5.13 only``.

        PolyScope X is omitted if it never got the feature, or if all its versions share it with the e-Series.
        """
        names = (Series.CB3.value, Series.E.value, "PolyScope X")
        late = self.x if self.x and (self.e is None or self.x > _FIRST_X) else None
        since = [f"{name} since {_first(v)}" for name, v in zip(names, (self.cb3, self.e, late), strict=True) if v]
        return f"{since[0]} only" if len(since) == 1 else ", ".join(since) or "no series"


def _first(version: PolyscopeVersion) -> str:
    """A version in its shortest form: 5.6, or 5.9.4."""
    return version.short if version.bugfix else f"{version.major}.{version.minor}"
