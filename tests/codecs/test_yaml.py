"""Untrusted YAML is plain data or one type of error, regardless of the loader's exceptions."""

import pytest

from tests.rows import each_row
from urproto.structures import InvalidYamlError, load_yaml

MULTIPLYING = "a0: &a0 [1, 1]\n" + "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9))


@each_row(
    ("text", "reason"),
    [
        ("2001-99-99", "month must be in 1..12"),
        ("a: !!int", "not what it looks like"),
        ("[" * 3000, "nested too deeply"),
        ("[x " * 2000, "nested too deeply"),
        ("a: &a [*a]", "contains itself"),
        (MULTIPLYING, "more than 1000000 values"),
        (b"a: \xe4", "utf-8"),
        ("a: [", "expected the node content"),
    ],
)
def test_invalid_documents_are_refused(text: str | bytes, reason: str) -> None:
    with pytest.raises(InvalidYamlError, match=reason):
        load_yaml(text)


def test_small_aliases_are_accepted() -> None:
    assert load_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: [*a, *a]") == {
        "a": {"x": 1},
        "b": {"x": 1, "y": 2},
        "c": [{"x": 1}, {"x": 1}],
    }
