"""The list of mutants matches the code, checked without the slow `make mutants`."""

import ast

import pytest

from tests.mutants.mutants import LIST, MIN_FOUND, MIN_MUTANTS, ROOT, GoneError, Mutant, changed, read_list

MUTANTS = read_list(LIST)


def test_every_mutant_matches_one_place_and_has_tests() -> None:
    for mutant in MUTANTS:
        file, text = changed(mutant, ROOT)
        assert ast.parse(text), f"no Python: {mutant}"
        assert text != file.read_text(), f"no bug: {mutant}"
        assert mutant.tests, f"nothing looks for it: {mutant}"
        for test in mutant.tests:
            assert (ROOT / test.partition("::")[0]).is_file(), f"{test} is gone: {mutant}"


def test_each_package_has_enough_mutants_and_few_are_undetected() -> None:
    assert len(set(MUTANTS)) == len(MUTANTS) >= MIN_MUTANTS
    assert sum(bool(mutant.missed) for mutant in MUTANTS) <= (1 - MIN_FOUND) * len(MUTANTS)
    for package in ("urproto", "urscript", "emulator", "client"):
        assert sum(mutant.package.split("/")[0] == package for mutant in MUTANTS) >= 0.1 * MIN_MUTANTS, package


@pytest.mark.parametrize("before", ["this occurs nowhere", "self"])
def test_a_missing_or_ambiguous_place_is_reported(before: str) -> None:
    with pytest.raises(GoneError, match=f"'{before}' occurs .* times in urproto/rtde"):
        changed(Mutant("urproto/rtde", before, "pass", ()), ROOT)
