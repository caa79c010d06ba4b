"""PolyScope versions, the two controller series, and which of them has a feature.

The series are told apart by the major version: CB3 is 3.x, e-Series is 5.x, and 10.x, which is PolyScope X on the same
arms. So a feature carries one "first version" for each of the three lines of software; ``None`` means that the line
never got it.
"""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Final

from urproto.compat import Self


class Series(Enum):
    """Controller generation. The control period is a property of the series [s]."""

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
        """Read ``"5.12"``, ``"3.15.8"`` or ``"3.15.8.106339"``.

        Raises ValueError when the text is not of that form.
        """
        if not re.fullmatch(r"[0-9]{1,9}\.[0-9]{1,9}(\.[0-9]{1,9}){0,2}", text.strip()):
            raise ValueError(
                f"{text!r} is not a PolyScope version: give major.minor[.bugfix[.build]], for example 3.15.8"
            )
        return cls(*(int(part) for part in text.strip().split(".")))

    @property
    def series(self) -> Series:
        """CB3 for 3.x, e-Series for everything newer."""
        return Series.CB3 if self.major < 5 else Series.E

    @property
    def is_polyscope_x(self) -> bool:
        """True for 10.x, which has the Robot API and programs of another format."""
        return self.major >= _POLYSCOPE_X

    @property
    def short(self) -> str:
        """Without the build: 3.15.8."""
        return f"{self.major}.{self.minor}.{self.bugfix}"

    def __str__(self) -> str:
        return f"{self.major}.{self.minor}.{self.bugfix}.{self.build}"


_POLYSCOPE_X: Final = 10
_FIRST_X: Final = PolyscopeVersion(10, 0)

DEFAULT_VERSION = {
    Series.CB3: PolyscopeVersion(3, 15, 8, 106339),  # from the console of a 3.15.8 simulator
    Series.E: PolyscopeVersion(5, 22, 0, 1161320),  # minor chosen for what clients need; the build number is a guess
}


# Which 10.x came with what 5.x, where nobody says it of a feature. Known pairs: optimovej (5.21, 10.8), UR15 (5.22,
# 10.8), UR7e (5.22, 10.9), UR8 Long (5.23, 10.11), the energies of RTDE (5.23, 10.11), friction scales (5.25.1,
# 10.12.1). That others of the same 5.x came in the same 10.x is a guess, and so is that 10.0 has all of 5.19.
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
    """The first 10.x with what an e-Series controller got in a 5.x."""
    return next((x for until, x in _COUNTERPARTS if first < until), _NEWEST)


@dataclass(frozen=True, slots=True)
class Availability:
    """The first version of each line of software that has a feature; None where it never came."""

    cb3: PolyscopeVersion | None
    e: PolyscopeVersion | None
    x: PolyscopeVersion | None

    @classmethod
    def since(cls, cb3: str | None, e: str | None, x: str | None = "") -> Self:
        """Build from version texts, ``None`` for a line without the feature.

        ``x``: the 10.x; without one it is that which came with the 5.x.
        """
        on_cb3, on_e, on_x = (PolyscopeVersion.parse(text) if text else None for text in (cb3, e, x))
        return cls(on_cb3, on_e, _counterpart(on_e) if x == "" and on_e else on_x)

    def first(self, version: PolyscopeVersion) -> PolyscopeVersion | None:
        """The first version with the feature in the line that a version is of."""
        if version.is_polyscope_x:
            return self.x
        return self.cb3 if version.series is Series.CB3 else self.e

    def covers(self, version: PolyscopeVersion) -> bool:
        """True when a controller of this version has the feature."""
        first = self.first(version)
        return first is not None and version >= first

    def __str__(self) -> str:
        """For people: ``CB3 since 3.12, e-Series since 5.6``, or ``e-Series since 5.13 only``.

        PolyScope X is not named where the arm has it all the same, or never got it.
        """
        names = (Series.CB3.value, Series.E.value, "PolyScope X")
        late = self.x if self.x and (self.e is None or self.x > _FIRST_X) else None
        since = [f"{name} since {_first(v)}" for name, v in zip(names, (self.cb3, self.e, late), strict=True) if v]
        return f"{since[0]} only" if len(since) == 1 else ", ".join(since) or "no series"


def _first(version: PolyscopeVersion) -> str:
    """A version as people say it when a feature came with it: 5.6, or 5.9.4."""
    return version.short if version.bugfix else f"{version.major}.{version.minor}"
