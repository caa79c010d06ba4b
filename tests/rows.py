"""Tables of which a single test tries every row.

Each item costs pytest some 8 ms, and every worker collects all of them. Where the rows of a table need neither fresh
fixtures nor several workers, one item for all of them proves the same.
"""

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

_Test = Callable[..., Any]


def each_row(
    names: str | Sequence[str], rows: Iterable[Any], ids: Callable[[Any], object] | Iterable[str] | None = None
) -> Callable[[_Test], _Test]:
    """As ``pytest.mark.parametrize``, in one test: it tries every row, and its failure shows every row that fails.

    The rows share the test's fixtures. ids: a function of a row's value, or a name for each row.
    """
    names = [name.strip() for name in names.split(",")] if isinstance(names, str) else [*names]
    table = list(_named(names, list(rows), ids))
    assert table, "a test of no rows"

    def decorate(test: _Test) -> _Test:
        if inspect.iscoroutinefunction(test):

            @functools.wraps(test)
            async def tried(*self: Any, **fixtures: Any) -> None:
                __tracebackhide__ = True
                with _all_rows() as row:
                    for name, values in table:
                        with row(name):
                            await test(*self, **fixtures, **values)
        else:

            @functools.wraps(test)
            def tried(*self: Any, **fixtures: Any) -> None:
                __tracebackhide__ = True
                with _all_rows() as row:
                    for name, values in table:
                        with row(name):
                            test(*self, **fixtures, **values)

        signature = inspect.signature(test)
        fixtures = [parameter for name, parameter in signature.parameters.items() if name not in names]
        assert len(fixtures) == len(signature.parameters) - len(names), f"{test.__name__} does not take {names}"
        tried.__signature__ = signature.replace(parameters=fixtures)  # type: ignore[attr-defined]
        return tried

    return decorate


def _named(names: list[str], rows: list[Any], ids: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Every row: its name, and its values by the names of the parameters."""
    given = list(ids) if ids is not None and not callable(ids) else [None] * len(rows)
    for index, (row, name) in enumerate(zip(rows, given, strict=True)):
        if hasattr(row, "values") and hasattr(row, "marks"):  # a pytest.param
            assert not row.marks, f"a row cannot be marked: {row}"
            name, values = row.id or name, row.values
        else:
            values = row if len(names) > 1 else (row,)
        words = (_word(ids(value) if callable(ids) else value) for value in values)
        yield name or "-".join(word or str(index) for word in words), dict(zip(names, values, strict=True))


def _word(value: object) -> str:
    return str(value if isinstance(value, str | int | float) else getattr(value, "__name__", ""))


@contextmanager
def _all_rows() -> Iterator[Callable[[str], Any]]:
    """Yields a context manager for each row; fails at the end if one of them did."""
    __tracebackhide__ = True
    failed: list[str] = []

    @contextmanager
    def row(name: str) -> Iterator[None]:
        __tracebackhide__ = True
        try:
            yield
        except (Exception, pytest.fail.Exception) as error:
            where = pytest.ExceptionInfo.from_exception(error).getrepr(style="short")
            failed.append(f"[{name}]\n{where}")

    yield row
    if failed:
        pytest.fail(f"{len(failed)} failed:\n\n" + "\n\n".join(failed), pytrace=False)
