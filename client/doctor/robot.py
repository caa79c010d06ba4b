"""The robot's calibration, and the versions of what talks to it."""

import platform
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from client import primary
from client.calibration import calibration_of, is_nominal, read_calibration
from client.errors import FileError
from urproto.errors import URError
from urproto.robots import Calibration, CalibrationError


class Grade(StrEnum):
    """How bad it is."""

    GOOD = "good"
    UNKNOWN = "cannot be seen"
    WEAK = "weak"  # works, but less well than it could
    BROKEN = "broken"  # something will not work


@dataclass(frozen=True, slots=True)
class Finding:
    """``mend``: the command, or what to do, where it is not good."""

    grade: Grade
    subject: str
    text: str
    mend: str = ""


def exit_status(findings: list[Finding]) -> int:
    """1 when something will not work, else 0."""
    return int(any(finding.grade is Grade.BROKEN for finding in findings))


_PACKAGES = ("ur-emulator", "ur-rtde", "pin", "numpy")


def examine_versions() -> Iterator[Finding]:
    """Of Python and of the packages that are here."""
    here = [f"Python {platform.python_version()}"]
    for package in _PACKAGES:
        try:
            here.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    yield Finding(Grade.GOOD, "versions", ", ".join(here))


def examine_calibration(host: str, file: Path | None = None, port_offset: int = 0) -> Iterator[Finding]:
    """Which arm it is, and whether the file is of this one."""
    subject = "calibration"
    again = f"ur-client calibration --robot-ip {host} -o {file or 'my_robot_calibration.yaml'}"
    try:
        with primary.BlockingPrimaryClient(host, primary.PORT + port_offset) as robot:
            found = calibration_of(robot.run(robot.core.kinematics_info()))
            nominal = is_nominal(found, robot.run(robot.core.configuration_data()))
    except CalibrationError as error:
        yield Finding(Grade.BROKEN, subject, str(error), "restore the calibration on the robot's pendant")
        return
    except URError as error:
        yield Finding(Grade.UNKNOWN, subject, str(error))
        return
    yield _compared(found, file, again, nominal=nominal)


def _compared(found: Calibration, file: Path | None, again: str, *, nominal: bool) -> Finding:
    if file is None:
        kind = "nominal (a simulated arm)" if nominal else "of its own"
        mend = "" if nominal else f"poses are right only with it: {again}"
        return Finding(Grade.GOOD, "calibration", f"{kind}, {found.hash}", mend)
    try:
        given = read_calibration(file)
    except FileError as error:
        return Finding(Grade.BROKEN, "calibration", str(error), again)
    if given.hash != found.hash:
        text = f"the robot's is {found.hash}, that of {file} is {given.hash}: another arm, or calibrated again"
        return Finding(Grade.BROKEN, "calibration", text, again)
    if not given.is_whole:
        return Finding(Grade.BROKEN, "calibration", f"the numbers in {file} do not give its hash", again)
    return Finding(Grade.GOOD, "calibration", f"{file} is this robot's, {found.hash}")
