"""Inputs kept by the fuzzer are read again; none of them may fail."""

from fuzz import kept
from targets import TARGETS

from tests.rows import each_row


@each_row("name", TARGETS)
def test_corpus(name: str) -> None:
    target = TARGETS[name]
    for data in [*target.seeds(), *kept(name)]:
        try:
            target(data)
        except Exception as error:
            raise AssertionError(f"{name} fails on {data!r}") from error
