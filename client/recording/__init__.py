"""Recordings of a robot: write, read, convert, plot, stream and replay them.

Most programs need only `Recorder` and `read`.
"""

from client.recording.background import BackgroundRecorder
from client.recording.files import Recorder, convert, open_writer, read
from client.recording.motion import JointPath, joint_path
from client.recording.plots import deviations, draw
from client.recording.recording import DEFAULT_FIELDS, Recording
from client.recording.tracking import Tracking

__all__ = [
    "DEFAULT_FIELDS",
    "BackgroundRecorder",
    "JointPath",
    "Recorder",
    "Recording",
    "Tracking",
    "convert",
    "deviations",
    "draw",
    "joint_path",
    "open_writer",
    "read",
]
