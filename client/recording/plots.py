"""Pictures of a recording: what was asked of the joints and what they did."""

from dataclasses import dataclass
from html import escape
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.recording.extras import extra
from client.recording.recording import Recording

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "Deviation", "deviations", "draw"]

FORMATS: Final = (".png", ".svg", ".pdf", ".html")
_JOINTS: Final = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")
_PANEL_IN: Final = (11.0, 2.6)  # inches
_DPI: Final = 110


@dataclass(frozen=True, slots=True)
class Deviation:
    """Of one joint, between target and actual: the largest and the root mean square, in rad or rad/s."""

    joint: str
    largest: float
    rms: float


def deviations(recording: Recording, kind: str = "q") -> list[Deviation]:
    """Of each joint's angle (``q``) or speed (``qd``). Raises RecordingError when one of both was not recorded."""
    error = recording[f"target_{kind}"] - recording[f"actual_{kind}"]
    return [
        Deviation(joint, float(np.max(np.abs(column))), float(np.sqrt(np.mean(column**2))))
        for joint, column in zip(_JOINTS, error.T, strict=True)
    ]


def draw(recording: Recording, path: Path, title: str = "") -> None:
    """Draw positions, speeds, their errors and the speed scaling, as far as they were recorded.

    path: .png, .svg, .pdf, or .html, a page that needs nothing else. Raises RecordingError.
    """
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(f"{path} is none of the formats of pictures: {', '.join(FORMATS)}")
    figure = _figure(recording, title)
    try:
        if path.suffix.lower() == ".html":
            path.write_text(_page(recording, figure, title), encoding="utf-8")
        else:
            figure.savefig(path, dpi=_DPI)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


def _figure(recording: Recording, title: str) -> "Figure":
    with extra("plots", "drawing"):
        from matplotlib.figure import Figure
    panels = [panel for panel in _PANELS if panel.drawable(recording)]
    if "actual_q" not in recording:
        raise RecordingError("there are no joint angles to draw: record actual_q, best beside target_q")
    width, height = _PANEL_IN
    figure = Figure(figsize=(width, height * len(panels)), layout="constrained")
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for axes, panel in zip(every, panels, strict=True):
        panel.draw(axes, recording)
        axes.grid(True, alpha=0.3)
        axes.margins(x=0.0)
    every[-1].set_xlabel("time [s]")
    lines = every[0].get_lines()
    figure.legend(
        [line for line in lines if line.get_label() in _JOINTS],
        _JOINTS,
        loc="outside upper center",
        ncols=len(_JOINTS),
        title=f"{title}\nas measured; dashed: as desired".replace("$", r"\$"),  # no formula
    )
    return figure


@dataclass(frozen=True, slots=True)
class _Pair:
    """Target (dashed) and actual of the six joints."""

    kind: str
    label: str

    def drawable(self, recording: Recording) -> bool:
        return f"actual_{self.kind}" in recording

    def draw(self, axes: "Axes", recording: Recording) -> None:
        time_s = recording.time_s
        for joint, column in zip(_JOINTS, recording[f"actual_{self.kind}"].T, strict=True):
            (line,) = axes.plot(time_s, column, linewidth=1.0, label=joint)
            if f"target_{self.kind}" in recording:
                target = recording[f"target_{self.kind}"][:, _JOINTS.index(joint)]
                axes.plot(time_s, target, "--", linewidth=1.4, alpha=0.7, color=line.get_color())
        axes.set_ylabel(self.label)


@dataclass(frozen=True, slots=True)
class _Error:
    """Target minus actual of the six joints."""

    kind: str
    label: str

    def drawable(self, recording: Recording) -> bool:
        return f"actual_{self.kind}" in recording and f"target_{self.kind}" in recording

    def draw(self, axes: "Axes", recording: Recording) -> None:
        error = recording[f"target_{self.kind}"] - recording[f"actual_{self.kind}"]
        for joint, column in zip(_JOINTS, error.T, strict=True):
            axes.plot(recording.time_s, column, linewidth=1.0, label=joint)
        axes.set_ylabel(self.label)


@dataclass(frozen=True, slots=True)
class _Scaling:
    """Speed scaling and slider."""

    def drawable(self, recording: Recording) -> bool:
        return bool(_scalings(recording))

    def draw(self, axes: "Axes", recording: Recording) -> None:
        for label, values in _scalings(recording).items():
            axes.plot(recording.time_s, 100.0 * values, linewidth=1.2, label=label)
        axes.set_ylabel("speed [%]")
        axes.set_ylim(-5.0, 110.0)
        axes.legend(fontsize="small", loc="lower right")


def _scalings(recording: Recording) -> dict[str, NDArray[Any]]:
    names = {"speed_scaling": "scaling", "target_speed_fraction": "slider"}
    return {label: recording[name] for name, label in names.items() if name in recording}


_PANELS: Final = (
    _Pair("q", "position [rad]"),
    _Pair("qd", "velocity [rad/s]"),
    _Error("q", "position error [rad]"),
    _Error("qd", "velocity error [rad/s]"),
    _Scaling(),
)


def _page(recording: Recording, figure: "Figure", title: str) -> str:
    drawing = StringIO()
    figure.savefig(drawing, format="svg")
    svg = drawing.getvalue()
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        "<style>body{font-family:sans-serif;margin:2em} td,th{padding:.2em 1em;text-align:right}"
        "svg{max-width:100%;height:auto}</style></head><body>\n"
        f"<h1>{escape(title)}</h1>\n{_facts(recording)}\n{svg[svg.index('<svg') :]}\n</body></html>\n"
    )


def _facts(recording: Recording) -> str:
    length = f"<p>{len(recording)} states, {recording.time_s[-1]:.2f} s</p>"
    if not _Error("q", "").drawable(recording):
        return length
    rows = "".join(
        f"<tr><th>{row.joint}</th><td>{row.largest:.5f}</td><td>{row.rms:.5f}</td></tr>"
        for row in deviations(recording)
    )
    heads = "<tr><th>position error</th><th>largest [rad]</th><th>rms [rad]</th></tr>"
    return f"{length}\n<table>{heads}{rows}</table>"
