"""What one interface does to another: every state of a robot with every event, on both series, against a table.

The table is `tests/golden/interactions.tsv`, with a source for each row; docs/reference/states.md shows it.
"""

import csv
from pathlib import Path
from typing import Final

import pytest

from tests.interactions.cell import COLUMNS, EVENTS, PORTS, STATES, observe, series_of
from urproto.versions import Series

TABLE: Final = Path(__file__).parents[1] / "golden" / "interactions.tsv"
_SERIES: Final = {"both": tuple(Series), "cb3": (Series.CB3,), "e": (Series.E,)}


def _rows() -> list[dict[str, str]]:
    with TABLE.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t", quoting=csv.QUOTE_NONE))


ROWS: Final = {(row["state"], row["event"], series): row for row in _rows() for series in _SERIES[row["series"]]}
_CASES: Final = [
    (*key, port)
    for key in ROWS
    for port in (PORTS if key[1] == "program sent" and key[0] == ".urp playing" else PORTS[:1])
]

_LATER: Final = pytest.mark.long


def _same(case: tuple[str, str, Series, str]) -> bool:
    """Whether CB3, which has a quarter of the control periods, shows the same."""
    state, event, series, _ = case
    return series is Series.E and ROWS[state, event, series]["series"] == "both"


def test_the_table_has_a_row_for_every_state_event_and_series() -> None:
    assert set(ROWS) == {(state, event, series) for state in STATES for event in EVENTS for series in series_of(state)}
    assert all(row["source"] for row in ROWS.values())


@pytest.mark.parametrize(
    ("state", "event", "series", "port"),
    [
        pytest.param(*case, id=f"{case[0]}-{case[1]}-{case[2].value}-{case[3]}", marks=_LATER if _same(case) else ())
        for case in _CASES
    ],
)
def test_interaction(tmp_path: Path, state: str, event: str, series: Series, port: str) -> None:
    row = ROWS[state, event, series]
    seen = observe(tmp_path, series, state, event, port)
    assert seen == {column: row[column] for column in COLUMNS}, row["source"]
