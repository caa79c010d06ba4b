"""Everything that the ledger has about one robot, for people and programs that ask."""

from collections.abc import Iterator
from typing import Final

from urproto.facts.releases import release_of
from urproto.facts.scope import Situation
from urproto.facts.tables import Fact, known, ledger, rows

_PRESENT: Final = "yes"
_ABSENT: Final = "no"


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
