"""What requests and answers of the Robot API hold: checked, and described in its OpenAPI document."""

from typing import Annotated, Literal

import msgspec

from urproto.robotapi import ROBOT_MODES, SAFETY_MODES, ProgramAction, StateAction

Name = Annotated[str, msgspec.Meta(min_length=1, max_length=200)]


class StateChange(msgspec.Struct):
    """What is to become of the arm."""

    action: StateAction


class ProgramStateChange(msgspec.Struct):
    """What is to become of the loaded program."""

    action: ProgramAction


class LoadProgram(msgspec.Struct):
    """The program to load, as before API 3.1.4."""

    programName: Name


class LoadedProgram(msgspec.Struct):
    """A program."""

    name: Name


class Done(msgspec.Struct):
    """It is done."""

    message: str


class RobotModeAnswer(msgspec.Struct):
    """What the arm is doing."""

    mode: Literal[ROBOT_MODES]  # type: ignore[valid-type]
    message: str


class SafetyModeAnswer(msgspec.Struct):
    """What the safety system says."""

    mode: Literal[SAFETY_MODES]  # type: ignore[valid-type]
    message: str


class ControlModeAnswer(msgspec.Struct):
    """Who the robot obeys."""

    mode: Literal["LOCAL", "REMOTE"]
    message: str


class OperationalModeAnswer(msgspec.Struct):
    """Which operational mode it is in."""

    mode: Literal["MANUAL", "AUTOMATIC"]
    message: str


class LoadedProgramAnswer(msgspec.Struct):
    """The loaded program."""

    name: str
    message: str


class ProgramStateAnswer(msgspec.Struct):
    """What the program is doing."""

    state: Literal["PLAYING", "PAUSED", "STOPPED"]
    message: str


class Program(msgspec.Struct, rename="camel"):
    """A stored program. Dates: milliseconds since 1970."""

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
    """What a program that was uploaded is called."""

    program_name: str
    message: str


class ApiError(msgspec.Struct):
    """Why a request was refused."""

    message: str


class InvalidPart(msgspec.Struct):
    """A part of a request, and what is wrong with it."""

    loc: list[str | int]
    msg: str
    type: str


class ValidationError(msgspec.Struct):
    """What is wrong with a request."""

    detail: list[InvalidPart]
