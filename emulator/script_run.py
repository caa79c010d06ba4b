"""Implements ``urscript run``: runs a file of URScript programs on an arm that is ready, without servers."""

import asyncio
import re
from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from emulator.batch import Batch, Stimulus, act
from emulator.clock import Clock, FastClock, RealClock
from emulator.config import choose_arm, controller_config
from emulator.controller import Controller
from emulator.peers.connection import Peers
from emulator.peers.file import read_peers
from emulator.programs.compiling import LIBRARY_SET
from emulator.servers.script_sockets import NetworkSockets, ScriptPort
from emulator.services.sockets import ScriptNetwork
from urproto.entry import SUCCESS, TROUBLE, usage_error
from urproto.robots import RobotModel
from urproto.robots.model import Joints
from urproto.text import number
from urproto.vectors import as_six
from urscript.errors import CompileError
from urscript.files import ScriptFile

if TYPE_CHECKING:
    from emulator.faults.injector import FaultInjector

Known: TypeAlias = tuple[int, str, dict[str, Any]]  # how many there are, and the verb that sets one

INTERRUPTED: Final = "interrupted"  # the failure of a run that was ended by Ctrl-C
_NUMBERED: Final = re.compile(r"([a-z-]+)(\d+)=([^@]+)(?:@(.+))?")
_INPUTS: Final[dict[str, Known]] = {
    "digital": (8, "set_digital_input", {"group": "standard"}),
    "configurable": (8, "set_digital_input", {"group": "configurable"}),
    "tool": (2, "set_digital_input", {"group": "tool"}),
    "analog": (2, "set_analog_input", {"tool": False}),
    "tool-analog": (2, "set_analog_input", {"tool": True}),
}
_REGISTERS: Final[dict[str, Known]] = {
    "bool": (128, "set_input_register", {"kind": "bit"}),
    "int": (48, "set_input_register", {"kind": "int"}),
    "float": (48, "set_input_register", {"kind": "double"}),
}
_TRUTHS: Final = {"true": 1.0, "false": 0.0}


@dataclass(frozen=True)
class Outcome:
    """The result of a run. status: the exit status; failure: the reason, or empty; robot_s: its robot time [s].

    journal: of a run that was recorded.
    """

    status: int
    failure: str = ""
    robot_s: float = 0.0
    journal: bytes = b""


def run(options: Namespace) -> int:
    """Compile and run the file; return the exit status."""
    try:
        return execute(options, print, page=options.page).status
    except ValueError as error:
        return usage_error("urscript run", error)


def execute(
    options: Namespace, print_line: Callable[[str], None], *, record: bool = False, page: Path | None = None
) -> Outcome:
    """Compile and run the file; `print_line` gets each line of the report. Raises ValueError for invalid options.

    record: whether the outcome has the journal; answers of an operator are not in it. page: where to write the page of
    the run, unless the file does not compile. Raises ValueError if it cannot be written, too.
    """
    setup, file = _prepared(options, record=record)
    controller = setup.controller
    problems = file.problems(LIBRARY_SET, controller.version)
    for problem in problems:
        print_line(problem.render(file.name))
    wrong = next((problem for problem in problems if isinstance(problem, CompileError)), None)
    if wrong is not None:
        return Outcome(TROUBLE, f"does not compile: line {wrong.line}: {wrong.message}")
    batch = setup.batch(file, print_line, options)
    with _paged(page, file, controller) as after_tick:
        setup.play(batch, options, after_tick)
    print_line(_final_state(batch, controller))
    journal = b"" if controller.recorder is None else controller.recorder.journal
    return Outcome(TROUBLE if batch.failure else SUCCESS, batch.failure, batch.time_s, journal)


def check(options: Namespace) -> None:
    """Raise ValueError for invalid options or a missing file. Nothing runs."""
    _prepared(options)


def _prepared(options: Namespace, *, record: bool = False) -> "tuple[Setup, ScriptFile]":
    """Create what the options describe. Raises ValueError."""
    try:
        return Setup.of(options, record=record), ScriptFile.read(options.file)
    except OSError as error:
        raise ValueError(f"{error.filename or options.file}: {error.strerror}") from error


@dataclass
class Setup:
    """A controller with a ready arm and its surroundings, as options describe them: what a run begins with."""

    controller: Controller
    stimuli: list[Stimulus]
    peers: Peers
    faults: "FaultInjector | None"

    @classmethod
    def of(cls, options: Namespace, peers: Peers | None = None, *, record: bool = False) -> "Setup":
        """Create it. peers: instead of those of the options. Raises ValueError or OSError."""
        model, _ = choose_arm(options.model, options.polyscope, options.arm)
        config = controller_config(
            options.model,
            polyscope=options.polyscope,
            running=True,
            popup_auto_close_s=0.0,
            arm=options.arm,
            seed=options.seed,
            world=options.world,
            gripper=options.gripper,
            gripper_object=options.gripper_object,
            initial_q=None if options.joints is None else _joints(options.joints, model),
        )
        stimuli = [stimulus(text, _INPUTS) for text in options.input]
        stimuli += [stimulus(text, _REGISTERS) for text in options.register]
        if peers is None:
            peers = Peers({}, {}) if options.peers is None else read_peers(options.peers)
        controller = Controller(config)
        if record:
            _record(controller)
        slider = {"fraction": options.speed_slider}
        act(controller, "set_speed_slider", slider, lambda: controller.speed.set_slider(options.speed_slider))
        return cls(controller, stimuli, peers, _injected(options, controller))

    def batch(self, file: "ScriptFile", print_line: Callable[[str], None], options: Namespace) -> Batch:
        """The run of a file."""
        return Batch(
            self.controller,
            file,
            print_line,
            trace=options.trace,
            timeout_s=options.timeout,
            answers=options.answer,
            stimuli=self.stimuli,
        )

    def play(self, batch: Batch, options: Namespace, after_tick: Callable[[], Any] = lambda: None) -> None:
        """Carry the run out. A fault that could not act, and a message that a peer still expects, fail it.

        after_tick: called after each control period.
        """
        network = ScriptNetwork(options.script_network)
        try:
            asyncio.run(_drive(batch, self.controller, options.speed, network, self.peers, after_tick))
        except KeyboardInterrupt:
            batch.stop(INTERRUPTED)
        for entry in self.faults.listing() if self.faults is not None else ():
            if entry["problem"]:
                batch.stop(f"the fault {entry['kind']} failed: {entry['problem']}")
        if unmet := next(filter(None, (log.unmet() for log in self.peers.logs)), ""):
            batch.stop(unmet)


def _record(controller: Controller) -> None:
    """Record a controller in memory, from now on."""
    from emulator.journal.file import JournalWriter, MemorySink  # would take a part of the start-up time, too
    from emulator.journal.recorder import Recorder, header_of

    memory = MemorySink()
    Recorder(JournalWriter(memory), header_of(controller.config), memory).attach(controller)


@contextmanager
def _paged(page: Path | None, file: ScriptFile, controller: Controller) -> Iterator[Callable[[], Any]]:
    """What to call after each control period; writes the page of the run at its end. Raises ValueError."""
    if page is None:
        yield lambda: None
        return
    from emulator.journal.recorder import product_version  # as above
    from emulator.journal.trace import Tracer
    from urproto.trace.page import library, packed, write_page

    library()
    tracer = Tracer(controller, file.name, product_version())
    yield lambda: tracer.period(controller, controller.time_s)
    tracer.trace.finish()
    try:
        write_page(page, file.name, packed(tracer.trace))
    except OSError as error:
        raise ValueError(f"{page}: {error.strerror}") from error


def _injected(options: Namespace, controller: Controller) -> "FaultInjector | None":
    """Inject the faults of the options, if any; those without a seed get that of the run. Raises ValueError."""
    if not options.fault:
        return None  # importing the catalogue would take a tenth of the start-up time
    from emulator.faults.catalogue import describe, parse_fault
    from emulator.faults.fault import FaultImpossibleError
    from emulator.faults.injector import FaultInjector

    injector = FaultInjector(controller)
    for text in options.fault:
        fault = parse_fault(text)
        try:
            seeded = replace(fault, seed=fault.seed or options.seed)
            arguments = {"kind": seeded.kind, **describe(seeded)}
            act(controller, "inject_fault", arguments, partial(injector.inject, seeded))
        except FaultImpossibleError as error:
            raise ValueError(f"{text}: {error}") from error
    return injector


def stimulus(text: str, known: Mapping[str, Known] = _INPUTS | _REGISTERS) -> Stimulus:
    """An input or register, as on the command line, as a stimulus. Raises ValueError."""
    match = _NUMBERED.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r} is not of the form NAME=VALUE or NAME=VALUE@SECONDS")
    kind, index = match[1], int(match[2])
    if kind not in known or index >= known[kind][0]:
        names = ", ".join(f"{name}0 to {count - 1}" for name, (count, *_) in known.items())
        raise ValueError(f"there is no {kind}{index}: choose from {names}")
    value = _TRUTHS.get(match[3].lower())
    value = number(match[3]) if value is None else value
    _, verb, arguments = known[kind]
    level = {"level": bool(value)} if verb == "set_digital_input" else {"value": value}
    if kind == "int" and not (value.is_integer() and abs(value) < 2**31):
        raise ValueError(f"{text!r}: an int register takes a 32-bit integer")
    return Stimulus(number(match[4] or "0"), verb, {**arguments, "index": index, **level})


def _joints(texts: Sequence[str], model: RobotModel) -> Joints:
    """Six joint angles [rad] within the joint limits. Raises ValueError."""
    angles = [number(text) for text in texts]
    lowest, highest = model.position_limits
    for joint, (angle, low, high) in enumerate(zip(angles, lowest, highest, strict=True)):
        if not low <= angle <= high:
            raise ValueError(f"joint {joint} cannot be at {angle:g} rad: give {low:g} to {high:g}")
    return as_six(angles)


async def _drive(
    batch: Batch,
    controller: Controller,
    speed: float | None,
    network: ScriptNetwork,
    peers: Peers,
    after_tick: Callable[[], Any],
) -> None:
    """Run control periods until the run is over. Raises what a period raises."""
    sockets = NetworkSockets(network, controller.messages.note, port=ScriptPort(lambda: controller.time_s))
    peers.attach(controller, sockets)
    if controller.recorder is not None:
        controller.recorder.wrap_backends(controller)
    period_s = controller.period_s
    clock: Clock = RealClock(period_s, speed) if speed else FastClock(period_s, lambda: len(sockets) > 0)
    over: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def tick() -> None:
        try:
            batch.tick()
            after_tick()
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
