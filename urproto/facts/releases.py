"""Build and date of each release.

The table has those that are known. Another version gets build and date of the nearest known release of its line, which
is a guess, but a deterministic one, and of the right size and form.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import chain
from typing import Final, NamedTuple

from urproto.facts.scope import Situation, line_of
from urproto.facts.tables import Certainty, Fact, availability, known, ledger, rows
from urproto.versions import PolyscopeVersion

_MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_BUILD_FOURTH: Final = PolyscopeVersion(3, 3)  # before, the build is the third number: 3.2.18654

_PRESENT: Final = "yes"
_ABSENT: Final = "no"


class Release(NamedTuple):
    """A version as its controller reports it.

    version: with the build. build, day, compiled, control_build: the facts that this follows from. ``day`` is the date
    that the dashboard shows; ``compiled`` is date and time, and control_build the build number, of the controller's
    software, which is another program than PolyScope.
    """

    version: PolyscopeVersion
    build: Fact
    day: Fact
    compiled: Fact
    control_build: Fact

    @property
    def date(self) -> str:
        """The date in the form of the dashboard: Jan 24 2022."""
        return _in_words(self.day.value)

    @property
    def message_date(self) -> str:
        """Date and time in the form of the version message, which depends on the version."""
        day, time = self.compiled.value.split()
        if not availability("version_message.numeric_date").covers(self.version):
            return f"{_in_words(day)}, {time}"
        year, month, of_month = day.split("-")
        return f"{of_month}-{month}-{year}, {time}"


def _in_words(day: str) -> str:
    year, month, of_month = day.split("-")
    return f"{_MONTHS[int(month) - 1]} {of_month} {year}"


def release_of(version: PolyscopeVersion) -> Release:
    """The release with this version; a build that the version states is kept."""
    known = _release(PolyscopeVersion(version.major, version.minor, version.bugfix))
    return known._replace(version=version) if version.build else known


@cache
def _release(version: PolyscopeVersion) -> Release:
    if version < _BUILD_FOURTH and version.bugfix == 0:
        version = _first_of_minor(version)
    build, compiled = _nearest("release.build", version), _nearest("release.compiled", version)
    day = _nearest("release.date", version)
    if day.is_guess:  # both programs are built at about the same time: of a release, one date tells the other
        near = _nearest("release.compiled", version, "release.date")
        day = near._replace(name=day.name, value=near.value.split()[0], certainty=Certainty.GUESS)
    if compiled.is_guess:
        compiled = compiled._replace(value=f"{day.value} 00:00:00")
    control_build = _nearest("release.control_build", version)
    return Release(replace(version, build=build.integer), build, day, compiled, control_build)


def _first_of_minor(version: PolyscopeVersion) -> PolyscopeVersion:
    """The first known release of a minor version, for versions that cannot be told without their build."""
    known = (release for release, _ in _of_line("release.build", version))
    return min((release for release in known if release.minor == version.minor), default=version)


def _nearest(name: str, version: PolyscopeVersion, *or_by: str) -> Fact:
    """The row of this release; of another, the last one before it in its line, else the first one after it."""
    known = dict(chain.from_iterable(_of_line(each, version) for each in (name, *or_by)))
    if version in known:
        return known[version]
    before = [release for release in known if release <= version]
    nearest = max(before) if before else min(known)
    return known[nearest]._replace(
        scope=version.short,
        certainty=Certainty.GUESS,
        source=f"that of {nearest.short}, the nearest release that is known",
    )


def _of_line(name: str, version: PolyscopeVersion) -> Iterator[tuple[PolyscopeVersion, Fact]]:
    for fact in rows(name):
        release = fact.holds.release
        if release is not None and line_of(release) == line_of(version):
            yield release, fact


def known_releases() -> tuple[PolyscopeVersion, ...]:
    """All releases of which anything is known, in order."""
    facts = chain.from_iterable(rows(f"release.{name}") for name in ("build", "date", "compiled", "control_build"))
    return tuple(sorted({release for fact in facts if (release := fact.holds.release)}))


def description(situation: Situation) -> Iterator[Fact]:
    """One fact for each name: those of the release first, then those of the other tables, in their order.

    What a version does not have yet is there with the value ``no``, and as certain as its first version.
    """
    release = release_of(situation.version)
    for stated in (release.build, release.day, release.compiled, release.control_build):
        yield stated._replace(doc=rows(stated.name)[0].doc)
    for name, (first, *_) in ledger().items():
        if first.table == "releases":
            continue
        if (found := known(name, situation)) is not None:
            yield found._replace(doc=first.doc)
        elif first.value == _PRESENT:
            yield first._replace(value=_ABSENT)
