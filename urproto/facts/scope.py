"""What a fact holds for: software lines, models, versions, and a simulator or an arm.

A scope is text with alternatives separated by semicolons, each of which is a sequence of words that must all hold:

    all                    everything
    cb3 | e | x            a software line (PolyScope X is ``x``, and not ``e``)
    ursim | arm            a personality
    ur10e                  a model
    5.11.9 | 5.4           a release, or all releases of a minor version
    >=3.3  <3.10  <=5.0.5  a range; needs the line, since 3.x and 5.x are not one sequence

``cb3 >=3.10; e >=5.4`` is what came with 3.10 and with 5.4.
"""

import operator
import re
from collections.abc import Callable
from functools import cache
from typing import Final, NamedTuple

from urproto.compat import StrEnum
from urproto.versions import Availability, PolyscopeVersion

_MODEL: Final = re.compile(r"ur\d+(e|long)?")
_VERSION: Final = re.compile(r"(?P<comparison>>=|<=|<)?(?P<version>\d+\.\d+(\.\d+)?)")
_COMPARISONS: Final[dict[str, Callable[[PolyscopeVersion, PolyscopeVersion], bool]]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "<": operator.lt,
}
_LINES: Final = ("cb3", "e", "x")


class Personality(StrEnum):
    """Whose properties a controller has where a simulator and a real arm differ."""

    URSIM = "ursim"
    ARM = "arm"


class Situation(NamedTuple):
    """A robot about which a fact is asked. An empty model is none in particular: only rows without a model hold."""

    version: PolyscopeVersion
    model: str = ""
    personality: Personality = Personality.URSIM


def line_of(version: PolyscopeVersion) -> str:
    """The software line of a version, as scopes name it."""
    return "x" if version.is_polyscope_x else version.series.name.lower()


class _Alternative(NamedTuple):
    line: str = ""
    personality: str = ""
    model: str = ""
    exact: str = ""
    ranges: tuple[tuple[str, PolyscopeVersion], ...] = ()

    def covers(self, situation: Situation) -> bool:
        version = situation.version
        return (
            self.line in ("", line_of(version))
            and self.personality in ("", situation.personality)
            and self.model in ("", situation.model)
            and (not self.exact or f"{version.short}.".startswith(f"{self.exact}."))
            and all(_COMPARISONS[how](_without_build(version), bound) for how, bound in self.ranges)
        )

    @property
    def first(self) -> PolyscopeVersion | None:
        """The bound of ``>=``, if there is one."""
        return next((bound for how, bound in self.ranges if how == ">="), None)


def _without_build(version: PolyscopeVersion) -> PolyscopeVersion:
    return PolyscopeVersion(version.major, version.minor, version.bugfix)


class Scope(NamedTuple):
    """A parsed scope, and its text."""

    text: str
    alternatives: tuple[_Alternative, ...]

    def covers(self, situation: Situation) -> bool:
        """Whether a fact with this scope holds in a situation."""
        return any(alternative.covers(situation) for alternative in self.alternatives)

    @property
    def release(self) -> PolyscopeVersion | None:
        """The release, if the scope is exactly one, such as ``5.11.9``."""
        exact = self.alternatives[0].exact
        return PolyscopeVersion.parse(exact) if exact.count(".") == 2 else None

    @property
    def availability(self) -> Availability:
        """The first version of each line, for a fact that is the existence of something."""
        first = {alternative.line: alternative.first for alternative in self.alternatives}
        cb3, e, x = (str(first[line]) if first.get(line) else None for line in _LINES)
        return Availability.since(cb3, e, x or "")


@cache
def parse_scope(text: str) -> Scope:
    """Parse a scope. Raises ValueError, which names the wrong word."""
    return Scope(text, tuple(_parse_alternative(part.split()) for part in text.split(";")))


def _parse_alternative(words: list[str]) -> _Alternative:
    line, personality, model, exact = "", "", "", ""
    ranges = list[tuple[str, PolyscopeVersion]]()
    for word in words:
        if word in _LINES:
            line = word
        elif word in list(Personality):
            personality = word
        elif match := _VERSION.fullmatch(word):
            if how := match["comparison"]:
                ranges.append((how, PolyscopeVersion.parse(match["version"])))
            else:
                exact = match["version"]
        elif _MODEL.fullmatch(word):
            model = word
        elif word != "all":
            raise ValueError(f"{word!r} is neither a line, a model, a version nor a personality")
    if ranges and not line:
        raise ValueError(f"the range in {' '.join(words)!r} needs its line: cb3, e or x")
    if not words:
        raise ValueError("an alternative is empty: write all")
    return _Alternative(line, personality, model, exact, tuple(ranges))
