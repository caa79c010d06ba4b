"""``urscript run``: a file of scripts on an arm that is ready, without servers and without waiting."""

import asyncio
import math
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from pathlib import Path

from emulator.batch import Batch
from emulator.clock import Clock, FastClock, RealClock
from emulator.config import ArmKind, ConfigError, choose_model, choose_version, read_surroundings
from emulator.controller import Controller, ControllerConfig
from emulator.programs.compiling import LIBRARY_SET
from emulator.programs.sockets import ScriptNetwork
from emulator.servers.script_sockets import NetworkSockets
from urscript.commands import SUCCESS, TROUBLE, USAGE_ERROR, Command
from urscript.errors import CompileError
from urscript.files import ScriptFile

__all__ = ["COMMAND"]


def _arguments(parser: ArgumentParser) -> None:
    parser.add_argument("file", metavar="FILE", help="a file of scripts; - is standard input")
    parser.add_argument("--model", default="ur3", help="the arm, for example ur3 or ur5e (default ur3)")
    parser.add_argument("--polyscope", help="PolyScope version (default: the usual one of the arm's series)")
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
        help="addresses that sockets and XML-RPC of the script may connect to (default any)",
    )
    parser.add_argument("--world", type=Path, metavar="WORLD", help="YAML file: what stands around the arm")
    parser.add_argument(
        "--arm",
        choices=list(ArmKind),
        default=ArmKind.IDEAL,
        help="ideal (the default): exactly where its targets are; dynamic: moved by torques, with friction",
    )
    parser.add_argument("--seed", type=int, default=0, help="of a dynamic arm's measurement noise")
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
    try:
        model = choose_model(options.model)
        version = choose_version(options.polyscope, model)
        world = read_surroundings(options.world)
        file = ScriptFile.read(options.file)
    except ConfigError as error:
        return _usage_error(str(error))
    except OSError as error:
        return _usage_error(f"{options.file}: {error.strerror}")
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
    )
    controller = Controller(config)
    batch = Batch(controller, file, _say, trace=options.trace, timeout_s=options.timeout)
    try:
        asyncio.run(_drive(batch, controller, options.speed, ScriptNetwork(options.script_network)))
    except KeyboardInterrupt:
        batch.stop("interrupted")
    _say(_final_state(batch, controller))
    return TROUBLE if batch.failure else SUCCESS


async def _drive(batch: Batch, controller: Controller, speed: float | None, network: ScriptNetwork) -> None:
    """Tick until the run is over. Raises what a tick raises."""
    sockets = NetworkSockets(network, controller.messages.note)
    controller.programs.socket_backend = sockets
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


COMMAND = Command("run", "run a file of scripts on an emulated arm, in virtual time", _arguments, _run)
