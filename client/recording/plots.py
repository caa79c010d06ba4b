"""Plots of a recording: desired and actual motion of the joints, for a screen or a thesis."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape
from io import BytesIO, StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError, extra
from client.recording.recording import Recording
from client.recording.tracking import Tracking
from urproto.durable import write_file
from urproto.joints import JOINT_LABELS, JOINT_NAMES
from urproto.modes import SafetyMode, mode_name

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FORMATS: Final = (".png", ".svg", ".pdf", ".html")
# Okabe and Ito's palette: distinguishable with colour blindness, and in grey
_COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_WIDTH_IN: Final = 7.2  # text width of a page, so that fonts keep their size there
_HEAD_IN: Final = 0.9
_DPI: Final = 170
_STYLE: Final[Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "legend.fontsize": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.5,
    "axes.prop_cycle": f"cycler('color', {list(_COLOURS)})",
    "path.simplify_threshold": 0.3,
    "svg.fonttype": "none",
}
_DESIRED: Final[dict[str, Any]] = {"linewidth": 3.2, "alpha": 0.35, "solid_capstyle": "butt"}
_ACTUAL: Final[dict[str, Any]] = {"linewidth": 0.9}
_STOPPED: Final = "#b40000"
_SAFE_MODES: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED)


@dataclass(frozen=True, slots=True)
class Deviation:
    """Largest and root-mean-square difference between desired and actual values of one joint, in rad or rad/s."""

    joint: str
    largest: float
    rms: float


def deviations(recording: Recording, kind: str = "q", controller: str | None = None) -> list[Deviation]:
    """Deviation of each joint's angle (``q``) or speed (``qd``) from the desired one.

    controller: as in `Recording.tracking`. Raises RecordingError if no desired values were recorded.
    """
    tracking = recording.tracking(controller)
    error = _error(tracking, kind)
    if not np.isfinite(error).any():
        raise RecordingError(f"target_{kind} or actual_{kind} was not recorded: there is nothing to compare")
    return [
        Deviation(joint, float(np.nanmax(np.abs(column))), float(np.sqrt(np.nanmean(column**2))))
        for joint, column in zip(_names(tracking), error.T, strict=True)
    ]


def draw(
    recording: Recording,
    path: Path | str,
    title: str = "",
    *,
    controller: str | None = None,
    limit_rad: float | None = None,
) -> None:
    """Plot positions, speeds, their errors and the speed scaling, as far as they were recorded.

    path: .png, .svg, .pdf, or .html for a self-contained page. controller: as in `Recording.tracking`. limit_rad:
    draw a line at this deviation from the path. Raises RecordingError.
    """
    path = Path(path)
    if path.suffix.lower() not in FORMATS:
        raise RecordingError(f"{path} is not a format of plots: choose one of {', '.join(FORMATS)}")
    with extra("plots", "drawing"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    if "actual_q" not in recording and not recording.controllers:
        raise RecordingError("there are no joint angles to plot: record actual_q, preferably with target_q")
    picture = _Picture(recording, recording.tracking(controller), limit_rad)
    with rc_context(_STYLE):
        figure = _figure(Figure, picture, title)
        if path.suffix.lower() == ".html":
            _write(path, _page(picture, figure, title))
        else:
            save_figure(figure, path, _DPI)


def draw_trajectory(time_s: NDArray[Any], q: NDArray[Any], qd: NDArray[Any], path: Path) -> None:
    """Plot joint angles and speeds (n, 6) over time [s] (n,). path: .png, .svg or .pdf. Raises RecordingError."""
    formats = FORMATS[:-1]
    if path.suffix.lower() not in formats:
        raise RecordingError(f"{path} is not a format of plots: choose one of {', '.join(formats)}")
    with extra("plots", "drawing"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    with rc_context(_STYLE):
        figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN * 0.7), layout="constrained")
        every = figure.subplots(2, 1, sharex=True)
        for axes, values, label in zip(every, (q, qd), ("angle [rad]", "speed [rad/s]"), strict=True):
            axes.plot(time_s, values, linewidth=0.9, label=list(JOINT_LABELS))
            axes.set_ylabel(label)
            axes.margins(x=0.0)
        every[0].legend(ncols=3)
        every[1].set_xlabel("time [s]")
        save_figure(figure, path, _DPI)


def save_figure(figure: "Figure", path: Path, dpi: int) -> None:
    """Write a figure in the format of the path's suffix. Raises RecordingError."""
    content = BytesIO()
    figure.savefig(content, dpi=dpi, format=path.suffix[1:])
    _write(path, content.getvalue())


def _write(path: Path, content: bytes | str) -> None:
    try:
        write_file(path, content)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror}") from error


@dataclass(frozen=True, slots=True)
class _Picture:
    """The data to plot."""

    recording: Recording
    tracking: Tracking
    limit_rad: float | None = None


@dataclass(frozen=True, slots=True)
class _Panel:
    """One set of axes: its height [in], whether there is anything to plot, and the function that plots it."""

    height_in: float
    has_data: Callable[[_Picture], bool]
    draw: Callable[["Axes", _Picture], None]


def _figure(kind: "type[Figure]", picture: _Picture, title: str) -> "Figure":
    panels = [panel for panel in _PANELS if panel.has_data(picture)]
    heights = [panel.height_in for panel in panels]
    figure = kind(figsize=(_WIDTH_IN, _HEAD_IN + sum(heights)), layout="constrained")
    figure.get_layout_engine().set(h_pad=0.03, w_pad=0.04)  # type: ignore[union-attr, call-arg]
    every = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    for axes, panel in zip(every, panels, strict=True):
        for begin_s, end_s, _ in _safety_stops(picture.recording):
            axes.axvspan(begin_s, end_s, color=_STOPPED, alpha=0.1, linewidth=0.0)
        panel.draw(axes, picture)
        axes.margins(x=0.0)
    figure.align_ylabels(every)
    every[-1].set_xlabel("time [s]")
    _add_legend(figure, every[0], picture, title)
    return figure


def _add_legend(figure: "Figure", axes: "Axes", picture: _Picture, title: str) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    names = _names(picture.tracking)
    lines: list[Artist] = [line for line in axes.get_lines() if line.get_label() in names]
    head = [title] if title else []
    if picture.tracking.compared:
        lines.append(Line2D([], [], color="black", label="desired", **_DESIRED))
        head.append(f"desired by: {picture.tracking.source}")
    lines.append(Line2D([], [], color="black", label="actual", **_ACTUAL))
    for text in dict.fromkeys(text for _, _, text in _safety_stops(picture.recording)):
        lines.append(Patch(color=_STOPPED, alpha=0.15, linewidth=0.0, label=text))
    figure.legend(
        handles=lines,
        loc="outside upper center",
        ncols=-(-len(lines) // 2),
        title="\n".join(head).replace("$", r"\$") or None,  # otherwise matplotlib reads it as a formula
        frameon=False,
    )


def _safety_stops(recording: Recording) -> Iterator[tuple[float, float, str]]:
    """Start, end [s] and name of each interval in which the safety system held the arm."""
    if "safety_mode" not in recording:
        return
    modes, time_s = recording["safety_mode"], recording.time_s
    edges = np.flatnonzero(np.diff(modes)) + 1
    for begin, end in zip([0, *edges], [*edges, len(modes) - 1], strict=True):
        if (mode := int(modes[begin])) not in _SAFE_MODES:
            yield float(time_s[begin]), float(time_s[end]), _mode_name(mode)


def _mode_name(mode: int) -> str:
    return mode_name(SafetyMode, mode).replace("_", " ").lower()


def _names(tracking: Tracking) -> tuple[str, ...]:
    known = dict(zip(JOINT_NAMES, JOINT_LABELS, strict=True))
    return tuple(known.get(joint, joint) for joint in tracking.joints)


def _error(tracking: Tracking, kind: str) -> NDArray[np.float64]:
    if kind == "q":
        return tracking.desired_q - tracking.actual_q
    return tracking.desired_qd - tracking.actual_qd


# the panels


def _pair(kind: str, label: str, height_in: float) -> _Panel:
    """Panel of the desired and actual values of all joints."""

    def columns(picture: _Picture) -> tuple[Any, Any]:
        tracking = picture.tracking
        return (tracking.desired_q, tracking.actual_q) if kind == "q" else (tracking.desired_qd, tracking.actual_qd)

    def has_data(picture: _Picture) -> bool:
        return bool(np.isfinite(columns(picture)[1]).any())

    def drawn(axes: "Axes", picture: _Picture) -> None:
        desired, actual = columns(picture)
        time_s = picture.tracking.time_s
        for joint, name in enumerate(_names(picture.tracking)):
            colour = f"C{joint}"
            axes.plot(time_s, desired[:, joint], color=colour, **_DESIRED)
            axes.plot(time_s, actual[:, joint], color=colour, label=name, **_ACTUAL)
        axes.set_ylabel(label)

    return _Panel(height_in, has_data, drawn)


def _error_panel(kind: str, label: str, unit: str, height_in: float) -> _Panel:
    """Panel of desired minus actual values of all joints at the same moment."""

    def drawn(axes: "Axes", picture: _Picture) -> None:
        error = _error(picture.tracking, kind)
        axes.plot(picture.tracking.time_s, error, linewidth=0.9)
        _set_note(axes, f"largest {np.nanmax(np.abs(error)):.4f} {unit}")
        axes.set_ylabel(f"{label}\n[{unit}]")

    return _Panel(height_in, lambda picture: bool(np.isfinite(_error(picture.tracking, kind)).any()), drawn)


def _draw_path_deviation(axes: "Axes", picture: _Picture) -> None:
    deviation = picture.tracking.path_deviation()
    axes.plot(picture.tracking.time_s, deviation, color="black", linewidth=0.9)
    _set_note(axes, f"largest {np.nanmax(deviation):.4f} rad")
    if picture.limit_rad is not None:
        axes.axhline(picture.limit_rad, color=_STOPPED, linewidth=0.8, linestyle="--")
    axes.set_ylabel("path deviation\n[rad]")
    axes.set_ylim(bottom=0.0, top=max(axes.get_ylim()[1], 1.2 * (picture.limit_rad or 0.0), 1e-3))


def _draw_speed(axes: "Axes", picture: _Picture) -> None:
    styles = (_DESIRED, _ACTUAL)  # most of the time, the two lines coincide
    for (label, values), style in zip(_speeds(picture.recording).items(), styles, strict=False):
        axes.plot(picture.recording.time_s, 100.0 * values, color="black", label=label, **style)
    axes.set_ylabel("speed [%]")
    axes.set_ylim(-5.0, 110.0)
    axes.set_yticks((0, 50, 100))
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0, ncols=2, frameon=False)


def _speeds(recording: Recording) -> dict[str, NDArray[Any]]:
    found = {}
    if "target_speed_fraction" in recording:
        found["slider"] = recording["target_speed_fraction"]
        if "speed_scaling" in recording:
            found["scaling, as controllers see it"] = recording["speed_scaling"] * recording["target_speed_fraction"]
    return found


def _set_note(axes: "Axes", text: str) -> None:
    axes.set_title(text, loc="right", fontsize="small", pad=2.0)


_PANELS: Final = (
    _pair("q", "position [rad]", 1.9),
    _pair("qd", "velocity [rad/s]", 1.5),
    _error_panel("q", "position error", "rad", 1.0),
    _error_panel("qd", "velocity error", "rad/s", 1.0),
    _Panel(0.9, lambda picture: picture.tracking.compared, _draw_path_deviation),
    _Panel(0.8, lambda picture: bool(_speeds(picture.recording)), _draw_speed),
)


# the page


def _page(picture: _Picture, figure: "Figure", title: str) -> str:
    drawing = StringIO()
    figure.savefig(drawing, format="svg")
    svg = drawing.getvalue()
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        "<style>body{font-family:sans-serif;margin:2em} td,th{padding:.2em 1em;text-align:right}"
        "svg{width:100%;max-width:70em;height:auto}</style></head><body>\n"
        f"<h1>{escape(title)}</h1>\n{_summary(picture)}\n{svg[svg.index('<svg') :]}\n</body></html>\n"
    )


def _summary(picture: _Picture) -> str:
    recording, tracking = picture.recording, picture.tracking
    length = f"<p>{len(recording)} states, {recording.time_s[-1]:.2f} s</p>"
    if not tracking.compared:
        return length
    rows = "".join(
        f"<tr><th>{row.joint}</th><td>{row.largest:.5f}</td><td>{row.rms:.5f}</td></tr>"
        for row in deviations(recording, controller=tracking.source)
    )
    heads = "<tr><th>position error</th><th>largest [rad]</th><th>rms [rad]</th></tr>"
    path = f"<p>largest deviation from the path: {tracking.largest_path_deviation:.5f} rad</p>"
    return f"{length}\n{path}\n<table>{heads}{rows}</table>"
