"""Random programs that call every built-in with numbers at and beyond all limits, and conditions that must hold.

`program(chance, model)` writes one, `run(text, model)` steps it in virtual time: the controller never fails itself, and
nothing that is not finite is published on any port.
"""

import logging
import math
from functools import cache
from random import Random
from typing import Any, Final

from emulator.commands.requests import RTDEInputs, ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.programs.compiling import LIBRARY_SET
from emulator.servers.primary_state import robot_state
from tests.networks import MemorySockets
from urproto.primary.messages import RuntimeExceptionMessage
from urproto.primary.state import encode_robot_state
from urproto.realtime import realtime_packer
from urproto.robots import load_model
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.versions import DEFAULT_VERSION
from urscript.builtins import Builtin

PERIODS: Final = 60
_NUMBERS: Final = (
    *("0", "1", "-1", "0.5", "3", "1e-300", "-0.0", "2147483647", "-2147483648", "1e7", "1e12", "1e13"),
    *("1e154", "1e155", "-1e200", "1e308", "-1e308", "1e308 * 10", "1e308 * 10 - 1e308 * 10", "1e-320"),
)
_MODEST: Final = ("0", "1", "-1", "0.5", "0.1", "-0.3", "2", "3.14")
_POSES: Final = (
    "get_actual_tcp_pose()",
    "get_target_tcp_pose()",
    "p[0, 0, 0, 0, 0, 0]",
    "get_forward_kin([0, -1.57, 0, -1.57, 0, 0])",
    "pose_add(get_target_tcp_pose(), p[0.1, 0, 0, 0, 0, 0])",
    "pose_add(get_target_tcp_pose(), p[1e-9, 0, 0, 0, 0, 1e-9])",
)
_STATEMENTS: Final = (
    "movel(get_actual_tcp_pose())",
    "movel(get_target_tcp_pose(), a=1e308, v=1e308)",
    "movej([0, -1.57, 0, -1.57, 0, 0], a=1e-300, v=1e-300, t=0.1)",
    "speedj([1e308, 0, 0, 0, 0, 0], 1e308, 0.1)",
    "sleep(1e308)",
    "set_payload(1e200, [1e200, 0, 0])",
    "force_mode(p[0, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1], [1e155, 0, 0, 0, 0, 0], 2, [1e155, 1, 1, 1, 1, 1])",
    "sync()",
    "stopj(1e308)",
    "n = n * 1e200",
    "n = n - n * 2",
    "x = " + " + ".join(["n"] * 140),
    "x = " + "-(" * 70 + "n" + ")" * 70,
    "x = " + "[" * 12 + "n" + "]" * 12,
    "textmsg(n, [n, n])",
)
_NEVER: Final = frozenset(["powerdown", "sleep", "popup", "socket_open", "halt"])  # ends, or waits


@cache
def builtins(model: str) -> tuple[Builtin, ...]:
    """All built-ins that a program for this arm can call."""
    available = LIBRARY_SET.available(DEFAULT_VERSION[load_model(model).series])
    return tuple(
        builtin
        for name, builtin in sorted(available.items())
        if name not in _NEVER and not name.startswith(("request_", "interpreter"))
    )


def number(chance: Random) -> str:
    return chance.choice(_NUMBERS if chance.random() < 0.4 else _MODEST)


def argument(chance: Random, title: str) -> str:
    """A value of a kind, occasionally one of another kind."""
    if chance.random() < 0.03:
        title = chance.choice(("Num", "List", "Pose", "Const String"))
    numbers = ", ".join(number(chance) for _ in range(6))
    match title:
        case "Num":
            return number(chance)
        case "Int":
            return chance.choice(("0", "1", "2", "3", "7", "24", "-1", "2147483647", "-2147483648", "1e9", "n"))
        case "Bool":
            return chance.choice(("True", "False"))
        case "Const String":
            return chance.choice(
                ('""', '"xmlrpc"', '"10.0.0.1:80"', '"world"', '"x"', '"1e999"', '"speed_slider_mask"')
            )
        case "Pose":
            return chance.choice((*_POSES, f"p[{numbers}]"))
        case "List of 6 numbers":
            return chance.choice(("[0, -1.5, 1.5, -1.6, -1.57, 0]", "get_actual_joint_positions()", f"[{numbers}]"))
        case "Pose or List of 6 numbers":
            return argument(chance, chance.choice(("Pose", "List of 6 numbers")))
        case "Matrix":
            return chance.choice(("[[1, 2], [3, 4]]", f"[[{number(chance)}, 0], [1, {number(chance)}]]"))
        case "List":
            return "[" + ", ".join(number(chance) for _ in range(chance.choice((0, 1, 3, 3, 6, 6, 8)))) + "]"
    return chance.choice((number(chance), '"x"', f"[{numbers}]", f"p[{numbers}]", "True"))


def call(chance: Random, builtin: Builtin) -> str:
    given = [p for p in builtin.parameters if p.required or chance.random() < 0.4]
    return f"{builtin.name}({', '.join(f'{p.names[0]}={argument(chance, p.kind.title)}' for p in given)})"


def program(chance: Random, model: str) -> str:
    """Some statements, a thread, and statements that run regardless of the rest."""

    def lines(count: int) -> str:
        picked = [
            chance.choice(_STATEMENTS) if chance.random() < 0.25 else call(chance, chance.choice(builtins(model)))
            for _ in range(count)
        ]
        return "".join(f"    {line}\n" for line in picked)

    return (
        f"def extreme():\n  n = {number(chance)} * 1.0\n  x = 0\n  x = None\n"
        f"  thread beside():\n{lines(2)}    sync()\n  end\n  run beside()\n"
        f"{lines(chance.randrange(1, 5))}  sleep(0.05)\nend\n"
    )


class _Errors(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(self.format(record))


def run(texts: list[str], model: str, chance: Random, *, dynamic: bool = False) -> Controller:
    """Run programs one after the other. AssertionError if a condition does not hold."""
    controller = Controller(ControllerConfig(model=load_model(model), running=True, dynamic=dynamic))
    controller.programs.socket_backend = MemorySockets(("10.0.0.1", 80))
    errors = _Errors()
    logging.getLogger("emulator").addHandler(errors)
    try:
        for text in texts:
            controller.post(ScriptUnit(text, "block"))
            for _ in range(PERIODS):
                if chance.random() < 0.05:
                    controller.post(RTDEInputs(rtde_inputs(chance)))
                controller.tick()
                check(controller, text)
                assert not errors.texts, f"{errors.texts}\n{text}"
            recover(controller)
    finally:
        logging.getLogger("emulator").removeHandler(errors)
    return controller


def rtde_inputs(chance: Random) -> dict[str, Any]:
    """Inputs that a client can write: any double."""
    name = chance.choice(sorted(INPUT_FIELDS))
    bad = chance.choice((math.nan, math.inf, -math.inf, 1e155, -1e308, 0.5))
    kind = INPUT_FIELDS[name].type
    one: Any = (
        bad if kind.letter == "d" else chance.random() < 0.5 if kind.letter == "?" else chance.choice((0, 1, 255))
    )
    return {name: one if kind.count == 1 else (one,) * kind.count}


def recover(controller: Controller) -> None:
    controller.programs.stop("the next one")
    for _ in range(5):
        controller.tick()


_FREE: Final = ("output_double_register", "input_double_register")  # keep whatever is written into them


def check(controller: Controller, text: str) -> None:
    """Conditions that must hold after every period."""
    problem = controller.guard.problem
    assert problem is None, f"{problem}\n{text}"
    snapshot = controller.snapshot
    for name, field in OUTPUT_FIELDS.items():
        if name.startswith(_FREE) or not field.available.covers(controller.version):
            continue
        value = getattr(snapshot, field.attribute)
        values = value if isinstance(value, tuple) else (value,)
        assert all(math.isfinite(one) for one in values if isinstance(one, float)), f"{name} is {value}\n{text}"
    if snapshot.step % 12 == 0:
        encode_robot_state(robot_state(snapshot, controller.model), controller.version, full=True)
        realtime_packer(controller.version)(snapshot)
    for message in snapshot.messages:
        message.encode(controller.version)
        if isinstance(message, RuntimeExceptionMessage):
            assert "internal error" not in message.text, f"{message.text}\n{text}"
