"""The list of mutants is about the code as it is: it does not take `make mutants`, which is slow, to find that out."""

import ast

import pytest

from tests.mutants.mutants import LEAST, LIST, ROOT, WANTED, GoneError, Mutant, changed, read_list

MUTANTS = read_list(LIST)


def test_every_mutant_changes_one_place_of_the_code_and_has_tests() -> None:
    for mutant in MUTANTS:
        file, text = changed(mutant, ROOT)
        assert ast.parse(text), f"no Python: {mutant}"
        assert text != file.read_text(), f"no bug: {mutant}"
        assert mutant.tests, f"nothing looks for it: {mutant}"
        for test in mutant.tests:
            assert (ROOT / test.partition("::")[0]).is_file(), f"{test} is gone: {mutant}"


def test_there_are_enough_of_each_package_and_few_that_nothing_finds() -> None:
    assert len(set(MUTANTS)) == len(MUTANTS) >= LEAST
    assert sum(bool(mutant.missed) for mutant in MUTANTS) <= (1 - WANTED) * len(MUTANTS)
    for package in ("urproto", "urscript", "emulator", "client"):
        assert sum(mutant.package.split("/")[0] == package for mutant in MUTANTS) >= 0.1 * LEAST, package


@pytest.mark.parametrize("before", ["this stands nowhere", "self"])
def test_a_place_that_is_gone_or_not_unique_is_told(before: str) -> None:
    with pytest.raises(GoneError, match=f"'{before}' stands .* times in urproto/rtde"):
        changed(Mutant("urproto/rtde", before, "pass", ()), ROOT)
