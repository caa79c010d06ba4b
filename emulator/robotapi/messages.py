"""Requests and answers of the Robot API: they are validated, and described in its OpenAPI document."""

from typing import Annotated, Literal

import msgspec

from urproto.robotapi import ROBOT_MODES, SAFETY_MODES, ProgramAction, StateAction

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


class StateChange(msgspec.Struct):
    """The requested action on the arm."""

    action: StateAction


class ProgramStateChange(msgspec.Struct):
    """The requested action on the loaded program."""

    action: ProgramAction


class LoadProgram(msgspec.Struct):
    """The program to load, in the form used before API 3.1.4."""

    programName: Name


class LoadedProgram(msgspec.Struct):
    """A program."""

    name: Name


class Done(msgspec.Struct):
    """The request is completed."""

    message: str


class RobotModeAnswer(msgspec.Struct):
    """The robot mode."""

    mode: Literal[ROBOT_MODES]  # type: ignore[valid-type]
    message: str


class SafetyModeAnswer(msgspec.Struct):
    """The safety mode."""

    mode: Literal[SAFETY_MODES]  # type: ignore[valid-type]
    message: str


class ControlModeAnswer(msgspec.Struct):
    """Whether the robot is in local or remote control."""

    mode: Literal["LOCAL", "REMOTE"]
    message: str


class OperationalModeAnswer(msgspec.Struct):
    """The operational mode."""

    mode: Literal["MANUAL", "AUTOMATIC"]
    message: str


class LoadedProgramAnswer(msgspec.Struct):
    """The loaded program."""

    name: str
    message: str


class ProgramStateAnswer(msgspec.Struct):
    """The state of the program."""

    state: Literal["PLAYING", "PAUSED", "STOPPED"]
    message: str


class Program(msgspec.Struct, rename="camel"):
    """A stored program. Dates are in milliseconds since 1970."""

    name: str
    description: str
    created_date: int
    last_saved_date: int | None
    last_modified_date: int | None
    program_state: str


class Programs(msgspec.Struct):
    """The stored programs."""

    programs: list[Program]
    message: str


class StoredProgram(msgspec.Struct, rename="camel"):
    """The name of an uploaded program."""

    program_name: str
    message: str


class ApiError(msgspec.Struct):
    """Why a request was refused."""

    message: str


class InvalidPart(msgspec.Struct):
    """An invalid part of a request, and the reason."""

    loc: list[str | int]
    msg: str
    type: str


class ValidationError(msgspec.Struct):
    """The invalid parts of a request."""

    detail: list[InvalidPart]
