"""Plot of recorded and predicted torques or currents of each joint over time."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from client.errors import RecordingError, extra
from client.identification.fidelity import UNITS, Fidelity
from client.recording.plots import save_figure
from urproto.joints import JOINT_LABELS

_FORMATS: Final = (".png", ".svg", ".pdf")
_SIZE_IN: Final = (10.0, 12.0)
_DPI: Final = 110
_MAX_POINTS: Final = 4000  # of a line; more would not be visible
_RECORDED: Final[Any] = {"linewidth": 0.7, "color": "#56b4e9", "label": "recorded"}
_PREDICTED: Final[Any] = {"linewidth": 0.9, "color": "#d55e00", "label": "predicted"}


def draw(result: Fidelity, path: Path, title: str) -> None:
    """Plot a column for each field and a row for each joint. path: .png, .svg or .pdf. Raises RecordingError."""
    if path.suffix.lower() not in _FORMATS:
        raise RecordingError(f"{path} is not a format of plots: choose one of {', '.join(_FORMATS)}")
    with extra("plots", "drawing"):
        from matplotlib.figure import Figure
    samples, names = result.samples, tuple(result.predicted)
    rows = samples.rows(_MAX_POINTS)
    time_s = samples.time_s[rows] - samples.time_s[0]
    figure = Figure(figsize=_SIZE_IN)
    every = figure.subplots(len(JOINT_LABELS), len(names), sharex=True, squeeze=False)
    for column, name in enumerate(names):
        recorded, predicted = samples.raw[name][rows], result.predicted[name][rows]
        every[0, column].set_title(f"{name} [{UNITS[name]}]", fontsize=9)
        for joint, axes in enumerate(every[:, column]):
            axes.plot(time_s, recorded[:, joint], **_RECORDED)
            axes.plot(time_s, predicted[:, joint], **_PREDICTED)
            axes.tick_params(labelsize=7)
            axes.margins(x=0.0)
            if not column:
                axes.set_ylabel(JOINT_LABELS[joint], fontsize=8)
    for axes in np.ravel(every[-1]):
        axes.set_xlabel("time [s]", fontsize=8)
    every[0, 0].legend(fontsize=7)
    figure.subplots_adjust(left=0.08, right=0.98, bottom=0.05, top=0.93, wspace=0.2, hspace=0.12)
    figure.suptitle(title.replace("$", r"\$"), fontsize=10)
    save_figure(figure, path, _DPI)
