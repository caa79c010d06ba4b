"""A library draws the plots; these tests check our numbers and the choice of panels."""

import struct
import sys
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from recording_rig import controller_state, record, recording
from typer.testing import CliRunner

from client.cli import app
from client.errors import MissingExtraError, RecordingError
from client.recording import Recorder, deviations, draw, read


def test_deviations_are_per_joint() -> None:
    target = np.zeros((4, 6))
    actual = target.copy()
    actual[:, 2] = (0.0, 0.3, -0.4, 0.0)
    rows = deviations(recording(np.arange(4.0), target, actual_q=actual))
    assert [row.largest for row in rows] == [0.0, 0.0, 0.4, 0.0, 0.0, 0.0]
    assert (rows[2].joint, rows[2].rms) == ("elbow", pytest.approx(0.25))


def test_a_png_has_a_size(states, tmp_path: Path) -> None:
    draw(read(record(tmp_path / "run.npz", states)), tmp_path / "run.png", "costs $5 & more")
    data = (tmp_path / "run.png").read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = struct.unpack(">II", data[16:24])
    assert width > 800
    assert height > 1000


def test_only_recorded_variables_are_plotted(states, tmp_path: Path) -> None:
    draw(read(record(tmp_path / "all.npz", states)), tmp_path / "all.svg")
    names = ("timestamp", "actual_q")
    few = [{name: state[name] for name in names} for state in states]
    draw(read(record(tmp_path / "few.npz", few)), tmp_path / "few.svg")
    assert (_panels(tmp_path / "all.svg"), _panels(tmp_path / "few.svg")) == (6, 1)


def _panels(path: Path) -> int:
    groups = ElementTree.parse(path).iter("{http://www.w3.org/2000/svg}g")
    return sum(group.get("id", "").startswith("axes_") for group in groups)


def test_controller_targets_and_stops_are_plotted(states, tmp_path: Path) -> None:
    stopped = [{**state, "safety_mode": 3 if 300 < number < 500 else 1} for number, state in enumerate(states)]
    file = tmp_path / "run.mcap"
    with Recorder(file, stopped[0]) as recorder:
        for state in stopped:
            recorder.write(state)
            recorder.write_controller("mine", controller_state(state["timestamp"], 0.1, 0.2))
    draw(read(file), str(tmp_path / "run.svg"), "two stops", limit_rad=0.02)
    text = (tmp_path / "run.svg").read_text()
    assert "desired by: mine" in text
    assert "protective stop" in text
    assert "largest 0.1000 rad" in text
    draw(read(file), tmp_path / "robot.svg", controller="robot")
    text = (tmp_path / "robot.svg").read_text()
    assert "desired by: robot" in text
    assert "largest 0.0000 rad" in text
    result = CliRunner().invoke(app, ["plot", str(file), "-o", str(tmp_path / "run.html"), "--limit", "0.02"])
    assert "desired by: mine" in result.output
    assert "largest deviation from the path: 0.24495 rad" in result.output  # of six joints
    assert "largest deviation from the path: 0.24495 rad" in (tmp_path / "run.html").read_text()


def test_a_page_is_self_contained(states, tmp_path: Path) -> None:
    draw(read(record(tmp_path / "run.npz", states)), tmp_path / "run.html", "<run> & more")
    page = Page()
    page.feed((tmp_path / "run.html").read_text())
    assert {"svg", "table", "h1"} <= page.tags
    assert not page.tags & {"script", "link", "img"}
    assert "<run> & more" in page.texts
    assert f"{len(states)} states, 2.00 s" in page.texts


class Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.texts: list[str] = []

    def handle_starttag(self, tag, attrs) -> None:
        self.tags.add(tag)

    def handle_data(self, data) -> None:
        self.texts.append(data)


def test_unplottable_recordings_are_reported(states, tmp_path: Path, monkeypatch) -> None:
    whole = read(record(tmp_path / "run.npz", states[:3]))
    with pytest.raises(RecordingError, match=r"not a format of plots: choose one of \.png"):
        draw(whole, tmp_path / "run.bmp")
    with pytest.raises(RecordingError, match="cannot write"):
        draw(whole, tmp_path / "nowhere" / "run.png")
    with pytest.raises(RecordingError, match="no joint angles"):
        draw(type(whole)({"timestamp": whole["timestamp"]}), tmp_path / "run.png")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[plots\]'"):
        draw(whole, tmp_path / "run.png")
