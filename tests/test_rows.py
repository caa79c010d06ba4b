import pytest

from tests.rows import each_row


async def test_all_rows_are_tried_and_those_that_fail_are_named() -> None:
    tried = []

    @each_row(("number", "limit"), [(1, 5), pytest.param(7, 5, id="seven"), (2, 0), (3, 9)])
    def small(number: int, limit: int) -> None:
        tried.append(number)
        assert number < limit

    @each_row("text", ["1", "x"], ids=lambda text: f"<{text}>")
    async def numeric(text: str) -> None:
        int(text)

    with pytest.raises(pytest.fail.Exception) as failure:
        small()
    assert tried == [1, 7, 2, 3]
    assert [line for line in str(failure.value).splitlines() if line.startswith("[")] == ["[seven]", "[2-0]"]
    with pytest.raises(pytest.fail.Exception, match=r"(?s)^1 failed:\n\n\[<x>\].*ValueError: invalid literal"):
        await numeric()


def test_rows_that_would_be_skipped_silently_are_refused() -> None:
    with pytest.raises(AssertionError, match="a row cannot be marked"):
        each_row("number", [pytest.param(1, marks=pytest.mark.long)])
    with pytest.raises(AssertionError, match="a test of no rows"):
        each_row("number", [])
