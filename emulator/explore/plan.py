"""The description of an exploration: a program and its surroundings, what may be chosen, and what must hold.

program: cell.script
model: ur5e
options: {arm: dynamic}       # of virtual_robot
peers: peers.yaml             # who answers the program
session: run.journal          # instead of model and options: a recorded run, whose messages are sent again
lasts: 20                     # robot time of a run [s]
at_most: 3                    # choices in a run
choices:
  operator pauses: {dashboard: pause, then: {dashboard: play, after: 0.1..3}}
properties:
  no_unexpected_stop: true
  finishes: {eventually: "program.running == false", within: 18}
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec

from emulator.config import ConfigError, read_yaml
from emulator.explore.choices import KINDS, Choice, PlanError, parse_choice
from emulator.explore.properties import Property, parse_property
from emulator.explore.session import ChangeMessage, Session
from urproto.robots import load_model
from urproto.structures import converted

_MAX_RUN_S = 3600.0
_USUAL_S = 20.0
_USUAL_MODEL = "ur5e"


class _File(msgspec.Struct, forbid_unknown_fields=True):
    choices: dict[str, Any]
    properties: dict[str, Any]
    program: str = ""
    session: str = ""
    model: str = ""
    options: dict[str, Any] = {}
    peers: str = ""
    lasts: float | None = None
    at_most: int = 3


@dataclass(frozen=True)
class Plan:
    """What `read_plan` returns. name: of the file that is explored."""

    name: str
    program: Path | None
    session: Session | None
    model: str
    options: Mapping[str, Any]
    peers: Path | None
    lasts_s: float
    at_most: int
    choices: Mapping[str, Choice]
    properties: tuple[Property, ...]

    @property
    def period_s(self) -> float:
        return load_model(self.model).series.period_s


def read_plan(path: Path) -> Plan:
    """The plan in a YAML file. Raises ConfigError, which names the file and what is wrong."""
    try:
        return plan_of(read_yaml(path), path.parent)
    except PlanError as error:
        raise ConfigError(f"{path}: {error}") from error


def plan_of(content: Any, folder: Path = Path()) -> Plan:
    """The plan that data describes. folder: to which its files are relative. Raises PlanError."""
    given = converted(content, _File, "", PlanError)
    if not given.program and not given.session:
        raise PlanError("an exploration needs a program or a session")
    if given.session and (given.model or given.options):
        raise PlanError("the model and the options are those of the session: leave them out")
    session = Session(folder / given.session, peers=bool(given.peers)) if given.session else None
    usual_s = _USUAL_S if session is None else session.lasts_s
    lasts_s = usual_s if given.lasts is None else given.lasts
    if not 0.0 < lasts_s <= _MAX_RUN_S:
        raise PlanError(f"lasts is a time up to {_MAX_RUN_S:g} s, not {lasts_s:g}")
    if given.at_most < 1:
        raise PlanError("at_most is at least 1")
    if not given.choices or not given.properties:
        raise PlanError("an exploration needs choices, and properties that must hold")
    files: dict[str, Any] = {
        name: folder / given.options[name] for name in ("world", "programs") if name in given.options
    }
    kinds = KINDS
    if session is not None:
        kinds = {**KINDS, "session": partial(ChangeMessage, session=session)}
    return Plan(
        given.program or given.session,
        folder / given.program if given.program else None,
        session,
        given.model or (_USUAL_MODEL if session is None else session.model),
        {**given.options, **files},
        folder / given.peers if given.peers else None,
        lasts_s,
        given.at_most,
        {name: parse_choice(name, entry, lasts_s, kinds) for name, entry in given.choices.items()},
        tuple(parse_property(name, entry) for name, entry in given.properties.items()),
    )
