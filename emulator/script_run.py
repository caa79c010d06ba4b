"""What ``urscript run`` does: a file of scripts on an arm that is ready, without servers and without waiting."""

import asyncio
import math
import re
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from emulator.batch import Batch, Stimulus
from emulator.clock import Clock, FastClock, RealClock
from emulator.config import read_surroundings
from emulator.controller import Controller, ControllerConfig
from emulator.io.signals import CONFIGURABLE, STANDARD, TOOL
from emulator.programs.compiling import LIBRARY_SET
from emulator.programs.sockets import ScriptNetwork
from emulator.robot.kinds import ArmKind
from emulator.script_peers import Peers, StubPeers, read_peers
from emulator.servers.script_sockets import NetworkSockets
from urproto.robots import START_Q, RobotModel
from urproto.robots.model import Joints
from urscript.commands import SUCCESS, TROUBLE, USAGE_ERROR, Command, add_controller_options, chosen_controller
from urscript.errors import CompileError
from urscript.files import ScriptFile


def _arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="a file of scripts; - is standard input")
    add_controller_options(parser)
    parser.add_argument(
        "--speed",
        type=_speed,
        metavar="max|N",
        help="N times real time; max (the default) is as fast as it goes, but real time while a script socket is open",
    )
    parser.add_argument("--timeout", type=_positive, metavar="SECONDS", help="stop after this much robot time")
    parser.add_argument(
        "--script-network",
        choices=list(ScriptNetwork),
        default=ScriptNetwork.ANY,
        help="addresses that sockets and XML-RPC of the script may connect to (default any, but no emulator's control "
        "API)",
    )
    parser.add_argument("--world", type=Path, metavar="WORLD", help="YAML file: what stands around the arm")
    parser.add_argument(
        "--arm",
        choices=list(ArmKind),
        default=ArmKind.IDEAL,
        help="ideal (the default): exactly where its targets are; dynamic: moved by torques, with friction",
    )
    parser.add_argument("--seed", type=int, default=0, help="of a dynamic arm's measurement noise")
    parser.add_argument("--joints", nargs=6, metavar="Q", help="six joint angles to start from [rad]")
    parser.add_argument(
        "--input",
        action="append",
        default=[],
        metavar="NAME=VALUE[@S]",
        help="an input from the beginning, or from robot time S on: digital0 to 7, configurable0 to 7, tool0 and 1 "
        "(0 or 1), analog0 and 1, tool-analog0 and 1 (V or A); repeatable",
    )
    parser.add_argument(
        "--register",
        action="append",
        default=[],
        metavar="NAME=VALUE[@S]",
        help="an input register, likewise: bool0 to 127, int0 to 47, float0 to 47; repeatable",
    )
    parser.add_argument(
        "--answer",
        action="append",
        default=[],
        metavar="TEXT",
        help="answer to a question of the program, as an operator types it; repeatable, in their order",
    )
    parser.add_argument(
        "--peers",
        type=Path,
        metavar="FILE",
        help="YAML file: what peers on sockets and XML-RPC answer (emulator.script_peers)",
    )
    parser.add_argument("--trace", action="store_true", help="show every statement before it is executed")


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def _speed(text: str) -> float | None:
    return None if text == "max" else _positive(text)


def _run(options: Namespace) -> int:

    return run(options)


COMMAND = Command("run", "run a file of scripts on an emulated arm, in virtual time", _arguments, _run)


Setter: TypeAlias = Callable[[Controller, int, float], Any]


def run(options: Namespace) -> int:
    """Compile and run the file; the exit status."""
    try:
        model, version = chosen_controller(options)
        world = read_surroundings(options.world)
        joints = START_Q if options.joints is None else _joints(options.joints, model)
        stimuli = [_stimulus(text, _INPUTS) for text in options.input]
        stimuli += [_stimulus(text, _REGISTERS) for text in options.register]
        peers = {} if options.peers is None else read_peers(options.peers)
        file = ScriptFile.read(options.file)
    except ValueError as error:
        return _usage_error(str(error))
    except OSError as error:
        return _usage_error(f"{error.filename or options.file}: {error.strerror}")
    problems = file.problems(LIBRARY_SET, version)
    for problem in problems:
        _say(problem.render(file.name))
    if any(isinstance(problem, CompileError) for problem in problems):
        return TROUBLE
    config = ControllerConfig(
        model=model,
        version=version,
        running=True,
        popup_auto_close_s=0.0,
        dynamic=options.arm == ArmKind.DYNAMIC,
        seed=options.seed,
        world=world,
        initial_q=joints,
    )
    controller = Controller(config)
    batch = Batch(
        controller,
        file,
        _say,
        trace=options.trace,
        timeout_s=options.timeout,
        answers=options.answer,
        stimuli=stimuli,
    )
    try:
        asyncio.run(_drive(batch, controller, options.speed, ScriptNetwork(options.script_network), peers))
    except KeyboardInterrupt:
        batch.stop("interrupted")
    _say(_final_state(batch, controller))
    return TROUBLE if batch.failure else SUCCESS


_NUMBERED: Final = re.compile(r"([a-z-]+)(\d+)=([^@]+)(?:@(.+))?")
_INPUTS: Final[Mapping[str, tuple[int, Setter]]] = {
    "digital": (8, lambda c, n, value: c.signals.set_digital_input(STANDARD, n, bool(value))),
    "configurable": (8, lambda c, n, value: c.signals.set_digital_input(CONFIGURABLE, n, bool(value))),
    "tool": (2, lambda c, n, value: c.signals.set_digital_input(TOOL, n, bool(value))),
    "analog": (2, lambda c, n, value: c.signals.analog_inputs.__setitem__(n, value)),
    "tool-analog": (2, lambda c, n, value: c.signals.tool_analog_inputs.__setitem__(n, value)),
}
_REGISTERS: Final[Mapping[str, tuple[int, Setter]]] = {
    "bool": (128, lambda c, n, value: c.registers.input.set_bit(n, bool(value))),
    "int": (48, lambda c, n, value: c.registers.input.set_int(n, int(value))),
    "float": (48, lambda c, n, value: c.registers.input.set_double(n, value)),
}
_TRUTHS: Final = {"true": 1.0, "false": 0.0}


def _stimulus(text: str, known: Mapping[str, tuple[int, Setter]]) -> Stimulus:
    """An input or register of the command line, as something that happens. Raises ValueError."""
    match = _NUMBERED.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not of the form NAME=VALUE or NAME=VALUE@SECONDS")
    kind, number = match[1], int(match[2])
    if kind not in known or number >= known[kind][0]:
        names = ", ".join(f"{name}0 to {count - 1}" for name, (count, _) in known.items())
        raise ValueError(f"there is no {kind}{number}: there are {names}")
    value = _TRUTHS.get(match[3].lower())
    value = _number(match[3]) if value is None else value
    set_it = known[kind][1]
    if kind == "int" and not (value.is_integer() and abs(value) < 2**31):
        raise ValueError(f"{text!r}: an int register holds a whole number of 32 bits")
    return Stimulus(_number(match[4] or "0"), lambda controller: set_it(controller, number, value))


def _joints(texts: Sequence[str], model: RobotModel) -> Joints:
    """Six joint angles [rad] that the arm can have. Raises ValueError."""
    angles = [_number(text) for text in texts]
    lowest, highest = model.position_limits
    for number, (angle, low, high) in enumerate(zip(angles, lowest, highest, strict=True)):
        if not low <= angle <= high:
            raise ValueError(f"joint {number} cannot be at {angle:g} rad: {low:g} to {high:g} are possible")
    a, b, c, d, e, f = angles
    return a, b, c, d, e, f


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not a number")
    return value


async def _drive(
    batch: Batch, controller: Controller, speed: float | None, network: ScriptNetwork, peers: Peers
) -> None:
    """Tick until the run is over. Raises what a tick raises."""
    sockets = NetworkSockets(network, controller.messages.note)
    controller.programs.socket_backend = StubPeers(peers, sockets)
    period_s = controller.period_s
    clock: Clock = RealClock(period_s, speed) if speed else FastClock(period_s, lambda: len(sockets) > 0)
    over: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def tick() -> None:
        try:
            batch.tick()
        except Exception as error:
            clock.close()
            over.set_exception(error)
        else:
            if batch.done:
                clock.close()
                over.set_result(None)

    clock.start(tick)
    try:
        await over
    finally:
        clock.close()
        await sockets.close()


def _final_state(batch: Batch, controller: Controller) -> str:
    snapshot = controller.snapshot
    joints = ", ".join(f"{q:.4f}" for q in snapshot.actual_q)
    pose = ", ".join(f"{value:.4f}" for value in snapshot.actual_TCP_pose)
    return "\n".join(
        [
            f"joints  [{joints}] rad",
            f"TCP     p[{pose}] m, rad",
            f"time    {batch.time_s:.3f} s",
            f"result  {batch.failure or 'finished'}",
        ]
    )


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


def _usage_error(message: str) -> int:
    sys.stderr.write(f"urscript run: {message}\n")
    return USAGE_ERROR
