"""What ``urscript run`` does: a file of scripts on an arm that is ready, without servers and without waiting."""

import asyncio
import sys
from argparse import Namespace

from emulator.batch import Batch
from emulator.clock import Clock, FastClock, RealClock
from emulator.config import read_surroundings
from emulator.controller import Controller, ControllerConfig
from emulator.programs.compiling import LIBRARY_SET
from emulator.programs.sockets import ScriptNetwork
from emulator.robot.kinds import ArmKind
from emulator.servers.script_sockets import NetworkSockets
from urscript.commands import SUCCESS, TROUBLE, USAGE_ERROR, chosen_controller
from urscript.errors import CompileError
from urscript.files import ScriptFile

__all__ = ["run"]


def run(options: Namespace) -> int:
    """Compile and run the file; the exit status."""
    try:
        model, version = chosen_controller(options)
        world = read_surroundings(options.world)
        file = ScriptFile.read(options.file)
    except ValueError as error:
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
