"""What a client sees of an emulator, one function for each observation in tests/golden/facts.tsv."""

import struct
from collections.abc import Callable
from typing import Any

from emulator.commands.requests import DashboardLine, RefusedScript, ScriptUnit
from emulator.config import EmulatorConfig
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from emulator.programs.loading import DRIVER_PROGRAMS
from emulator.servers.primary import greeting
from emulator.servers.primary_state import robot_state
from emulator.servers.rtde_session import RTDEHost, RTDESession
from emulator.services.urcap import DriverAddress
from emulator.snapshot import Snapshot
from tests.ticking import ticked
from urproto.facts import Situation
from urproto.modes import SafetyMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.primary.state import encode_robot_state
from urproto.robotapi import api_version
from urproto.robots import load_model
from urscript.work import run_to_end

OBSERVATIONS: dict[str, Callable[[Situation], str]] = {}
_PATIENCE = 6000  # control periods: an endless loop is stopped after ten seconds


def observation(name: str) -> Callable[[Callable[[Situation], str]], Callable[[Situation], str]]:
    def register(function: Callable[[Situation], str]) -> Callable[[Situation], str]:
        OBSERVATIONS[name] = function
        return function

    return register


def _config(situation: Situation, **options: Any) -> ControllerConfig:
    version, model, personality = situation
    return ControllerConfig(model=load_model(model), version=version, personality=personality, **options)


def _running(situation: Situation) -> Controller:
    controller = Controller(_config(situation, running=True))
    controller.tick()
    return controller


def _ask(situation: Situation, line: str) -> str:
    controller, answers = Controller(_config(situation)), list[Any]()
    controller.post(DashboardLine(line), answers.append)
    controller.tick()
    return str(answers[0])


def _written(values: Any) -> str:
    return " ".join(f"{value:g}" for value in (values if isinstance(values, tuple) else (values,)))


def _last_code(controller: Controller) -> str:
    """The last error code, up to a protective stop."""
    label = "none"
    for _ in range(_PATIENCE):
        snapshot = ticked(controller)
        codes = [message.label for message in snapshot.messages if isinstance(message, ErrorCodeMessage)]
        label = codes[-1] if codes else label
        if codes and snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP:
            break
    return label


def _message(situation: Situation, number: int) -> bytes:
    """A message of the greeting, without its header and the twelve bytes that follow it."""
    data = greeting(situation)
    for _ in range(number):
        data = data[struct.unpack_from(">i", data)[0] :]
    return data[15 : struct.unpack_from(">i", data)[0]]


def _first_state(situation: Situation) -> bytes:
    controller = _running(situation)
    return encode_robot_state(robot_state(controller.snapshot, controller.model), controller.version, full=True)


@observation("software")
def _software(situation: Situation) -> str:
    return _ask(situation, "PolyscopeVersion").removeprefix("URSoftware ").split(" (")[0]


@observation("software date")
def _date(situation: Situation) -> str:
    return _ask(situation, "PolyscopeVersion").split(" (")[1].removesuffix(")")


@observation("version message")
def _version_message(situation: Situation) -> str:
    body = _message(situation, 0)
    major, minor, bugfix, build = struct.unpack_from(">BBii", body, 10)
    return f"{15 + len(body)} {major}.{minor}.{bugfix} build {build} {body[20:].decode()}"


@observation("build of URControl")
def _control_build(situation: Situation) -> str:
    return str(struct.unpack_from(">i", _message(situation, 0), 16)[0])


@observation("message 12")
def _message_12(situation: Situation) -> str:
    return " ".join(map(str, struct.unpack(">iiB", _message(situation, 1))))


@observation("size of the first state")
def _size(situation: Situation) -> str:
    return str(len(_first_state(situation)))


@observation("state")
def _parts(situation: Situation) -> str:
    data, parts = _first_state(situation)[5:], list[str]()
    while data:
        size, kind = struct.unpack_from(">iB", data)
        parts.append(f"{kind}:{size}")
        data = data[size:]
    return " ".join(parts)


@observation("RTDE")
def _rtde(situation: Situation) -> str:
    config = EmulatorConfig(controller=_config(situation), ephemeral_ports=True)
    return "yes" if "rtde" in config.wanted_ports else "no"


@observation("interpreter port")
def _interpreter(situation: Situation) -> str:
    config = EmulatorConfig(controller=_config(situation), ephemeral_ports=True)
    return "yes" if "interpreter" in config.wanted_ports else "no"


@observation("version of the Robot API")
def _robot_api(situation: Situation) -> str:
    return api_version(situation.version)


@observation("RTDE until confirmed")
def _unconfirmed(situation: Situation) -> str:
    snapshot = Snapshot(safety_confirmed=False)
    session = RTDESession(RTDEHost(situation.version, lambda: snapshot), lambda values: None, lambda text: None)
    (warning,) = session.greeting()
    return warning.encode(1)[4:].decode()


@observation("get serial number")
def _serial_number(situation: Situation) -> str:
    return _ask(situation, "get serial number")


@observation("height of the tool")
def _height(situation: Situation) -> str:
    return f"{_running(situation).snapshot.actual_TCP_pose[2]:.3f}"


@observation("robot current per sum of joint currents")
def _current_share(situation: Situation) -> str:
    snapshot = _running(situation).snapshot
    return f"{snapshot.actual_robot_current / sum(map(abs, snapshot.actual_current)):g}"


@observation("robot current")
def _current(situation: Situation) -> str:
    return "drawn" if 0.5 < _running(situation).snapshot.actual_robot_current < 0.9 else "none"


@observation("joint voltages")
def _voltages(situation: Situation) -> str:
    below = (48.0 - volts for volts in _running(situation).snapshot.actual_joint_voltage)
    return "below the supply" if all(0.1 < drop < 0.3 for drop in below) else "others"


@observation("play in local control")
def _play(situation: Situation) -> str:
    config = _config(situation, running=True, external_control=DriverAddress("127.0.0.1", 1))
    controller, answers = Controller(config), list[Any]()
    run_to_end(controller.programs.load_steps(DRIVER_PROGRAMS / "external_control.urp"))
    controller.post(DashboardLine("play"), answers.append)
    controller.tick()
    return str(answers[0]) if answers else "program requested"


@observation("code of an RTDE watchdog")
def _watchdog(situation: Situation) -> str:
    controller = _running(situation)
    text = 'def watched():\n  rtde_set_watchdog("input_int_register_0", 10, "stop")\n  sleep(9)\nend\n'
    controller.post(ScriptUnit(text, "block"))
    return _last_code(controller)


@observation("code of protective_stop()")
def _protective_stop(situation: Situation) -> str:
    controller = _running(situation)
    controller.post(ScriptUnit("def stop():\n  protective_stop()\nend\n", "block"))
    return _last_code(controller)


@observation("code of an endless loop")
def _endless(situation: Situation) -> str:
    controller = _running(situation)
    controller.post(ScriptUnit("def busy():\n  while True:\n    i = 1\n  end\nend\n", "block"))
    return _last_code(controller)


@observation("code of a script in local control")
def _local(situation: Situation) -> str:
    controller = _running(situation)
    controller.post(RefusedScript("def late():\nend\n"))
    return _last_code(controller)


@observation("list of another size")
def _list(situation: Situation) -> str:
    controller = _running(situation)
    controller.post(ScriptUnit('def sizes():\n  v = [1, 2]\n  v = [1]\n  textmsg("taken")\nend\n', "block"))
    texts = [getattr(message, "text", "") for _ in range(100) for message in ticked(controller).messages]
    return "taken" if "taken" in texts else "refused"


def observe(name: str, situation: Situation) -> str:
    """An observation by its name; the names of variables are those of the snapshot of a running arm."""
    if name in OBSERVATIONS:
        return OBSERVATIONS[name](situation)
    return _written(getattr(_running(situation).snapshot, name))
