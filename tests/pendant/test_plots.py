"""Updates of the plots of a browser, and their export."""

import math
from pathlib import Path
from typing import Any

import pytest

from client.pendant.feeds import Feed
from client.pendant.plots import PRESETS, Plots, catalogue, series
from client.recording.tables import read_csv
from tests.rows import each_row
from urproto.rtde.fields import OUTPUT_FIELDS, available_fields
from urproto.versions import PolyscopeVersion

OLDEST = [PolyscopeVersion(3, 3), PolyscopeVersion(5, 0)]


class FakeFeeds:
    """Feeds without robots."""

    def __init__(self) -> None:
        self.subscribed = list[Feed]()

    def subscribe(self, names: Any, rate_hz: float, keep_rows: bool = False, predecessor: Feed | None = None) -> Feed:
        feed = Feed([name for name in OUTPUT_FIELDS if name in names], keep_rows)
        if predecessor is not None:
            feed.inherit_rows(predecessor)
        self.subscribed.append(feed)
        return feed

    def unsubscribe(self, feed: Feed, linger_s: float = 0.0) -> None:
        self.subscribed.remove(feed)


def create_plots(*keys: str) -> tuple[Plots, FakeFeeds]:
    feeds = FakeFeeds()
    plots = Plots(feeds)  # type: ignore[arg-type]
    plots.panes = plots.panes[:1]
    plots.choose(plots.panes[0], series(*keys))
    plots.show()
    return plots, feeds


def test_every_rtde_number_can_be_plotted() -> None:
    for version in (*OLDEST, PolyscopeVersion(5, 26)):
        known = catalogue(version)
        fields = available_fields(OUTPUT_FIELDS, version)
        assert {one.field for one in known.values()} == set(fields)
        assert len(known) == sum(field.type.count for field in fields.values()) + 2 * 18
        for keys in PRESETS.values():
            assert set(keys) <= set(known)


@each_row(
    ("key", "label", "shown_unit", "factor"),
    [
        ("actual_q[3]", "actual_q Wrist 1", "°", 180 / math.pi),
        ("actual_TCP_pose[2]", "actual_TCP_pose Z", "mm", 1000.0),
        ("actual_TCP_pose[3]", "actual_TCP_pose RX", "°", 180 / math.pi),
        ("actual_TCP_force[5]", "actual_TCP_force RZ", "Nm", 1.0),
        ("payload_inertia[3]", "payload_inertia Ixy", "kg m²", 1.0),
        ("actual_momentum", "actual_momentum", "kg m/s", 1.0),
        ("actual_digital_output_bits>>17", "TO1", "", 1.0),
    ],
)
def test_signal_labels_and_units(key: str, label: str, shown_unit: str, factor: float) -> None:
    one = catalogue(None)[key]
    assert (one.label, one.shown_unit, one.factor) == (label, shown_unit, pytest.approx(factor))


def test_each_row_is_sent_once() -> None:
    plots, feeds = create_plots("actual_q[1]", "actual_digital_output_bits>>3", "payload")
    feed = feeds.subscribed[0]
    head = ["timestamp", "actual_q[1]", "actual_digital_output_bits>>3", "payload"]
    assert plots.next_update(True) == [head, []]
    assert plots.next_update(False) is None
    feed.append_state({"timestamp": 1.0, "actual_q": (0.0, 0.1, 0.0, 0.0, 0.0, 0.0), "actual_digital_output_bits": 8})
    assert plots.next_update(False) == [None, [1.0, 0.1, 1, None]]
    feed.append_state(
        {"timestamp": 2.0, "actual_q": (0.0, math.inf, 0.0, 0.0, 0.0, 0.0), "actual_digital_output_bits": 7}
    )
    assert plots.next_update(False) == [None, [2.0, None, 0, None]]
    assert plots.next_update(False) is None
    assert plots.next_update(True) == [head, [1.0, 0.1, 1, None, 2.0, None, 0, None]]
    plots.clear()
    assert plots.next_update(False) == [head, []]
    assert plots.count == 0


def test_history_is_sent_in_parts_up_to_longest_window() -> None:
    plots, feeds = create_plots("speed_scaling")
    for i in range(30_000):
        feeds.subscribed[0].append_state({"timestamp": i * 0.008, "speed_scaling": 1.0})
    got = plots.next_update(True)[1]
    assert got[0] == pytest.approx(29_999 * 0.008 - 120.0, abs=0.01)
    while (more := plots.next_update(False)) is not None:
        assert len(more[1]) <= 20_000
        got += more[1]
    assert got[::2] == pytest.approx([i * 0.008 for i in range(30_000 - len(got) // 2, 30_000)])


def test_changing_signals_keeps_collected_rows() -> None:
    plots, feeds = create_plots("actual_q[1]")
    feeds.subscribed[0].append_state({"timestamp": 1.0, "actual_q": (0.5,) * 6})
    plots.choose(plots.panes[0], series("actual_q[2]", "speed_scaling"))
    assert len(feeds.subscribed) == 1
    assert plots.next_update(False) == [["timestamp", "actual_q[2]", "speed_scaling"], [1.0, 0.5, None]]
    with pytest.raises(ValueError, match="choose 24 at most"):
        plots.choose(plots.panes[0], list(catalogue(None).values())[:25])


def test_hiding_unsubscribes_and_keeps_rows() -> None:
    plots, feeds = create_plots("speed_scaling")
    feeds.subscribed[0].append_state({"timestamp": 1.0, "speed_scaling": 0.25})
    plots.hide()
    plots.hide()
    assert not feeds.subscribed
    assert plots.next_update(True) is None
    plots.show()
    assert plots.next_update(False) == [["timestamp", "speed_scaling"], [1.0, 0.25]]


async def test_csv_is_a_recording_with_full_precision(tmp_path: Path) -> None:
    plots, feeds = create_plots("actual_q[1]", "robot_mode")
    with pytest.raises(ValueError, match="no data has been collected"):
        await plots.csv()
    q = (1 / 3, 0.1 + 0.2, 1e-17, -2.0, 1e300, 5e-324)
    feeds.subscribed[0].append_state({"timestamp": 0.008, "actual_q": q, "robot_mode": 7})
    feeds.subscribed[0].append_state({"timestamp": 0.016, "actual_q": q, "robot_mode": 5})
    file = tmp_path / "plots.csv"
    file.write_bytes(await plots.csv())
    recording = read_csv(file)
    assert recording["actual_q"].tolist() == [list(q), list(q)]
    assert recording["robot_mode"].tolist() == [7, 5]
    assert recording["timestamp"].tolist() == [0.008, 0.016]
