"""Saves the state of a robot as a document, and restores it.

At rest, these are plain values: everything that outlives a program. A running program is a stack of Python frames, so
the document of a robot that runs or moves is the journal of its run, which is executed again.
"""

from base64 import b64encode
from collections.abc import Callable, Mapping
from enum import Enum
from typing import TYPE_CHECKING, Any, Final

from emulator.lifecycle.power import PowerState
from emulator.robot.installation import Payload
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import RuntimeState
from urproto.text import from_readable, readable
from urproto.vectors import ZERO6

if TYPE_CHECKING:
    from emulator.controller import Controller


_FORMAT: Final = 1
_AT_REST: Final = (PowerState.OFF, PowerState.IDLE, PowerState.RUNNING)

# section of the document -> what holds its values, and their attributes
_SECTIONS: Final[dict[str, tuple[Callable[["Controller"], Any], tuple[str, ...]]]] = {
    "controller": (lambda c: c, ("step_count", "user_role", "operational_mode", "remote_control")),
    "installation": (lambda c: c.installation, ("name", "gravity", "base_acceleration")),
    "speed": (lambda c: c.speed, ("slider",)),
    "input_registers": (lambda c: c.registers.input, ("bits", "ints", "doubles")),
    "output_registers": (lambda c: c.registers.output, ("bits", "ints", "doubles")),
    "signals": (
        lambda c: c.signals,
        (
            "digital_inputs",
            "digital_outputs",
            "analog_inputs",
            "analog_input_domains",
            "analog_output_ratios",
            "analog_output_domains",
            "tool_analog_inputs",
            "tool_analog_input_domains",
            "tool_voltage",
            "tool_output_mode",
            "tool_digital_output_modes",
        ),
    ),
    "programs": (lambda c: c.programs, ("flags",)),
    "electrics": (lambda c: c.electrics, ("energy_J", "braking_energy_J", "periods")),
    "temperatures": (lambda c: c.electrics.thermals, ("joints", "tool", "box", "elapsed_s")),
}


def save_state(controller: "Controller") -> dict[str, Any]:
    """The state as a document. Raises NotPossible for a robot that neither is at rest nor has a journal."""
    try:
        return state_at_rest(controller)
    except NotPossible:
        if controller.recorder is None or not (journal := controller.recorder.journal):
            raise
        return journal_document(controller, journal)


def state_at_rest(controller: "Controller") -> dict[str, Any]:
    """The state of a robot at rest as plain values. Raises NotPossible for another one."""
    check_rest(controller)
    payload = controller.installation.payload
    return {
        **_kind(controller),
        "q_rad": list(controller.motion.q),
        "tcp": list(controller.installation.tcp),
        "payload": {"mass_kg": payload.mass, "cog_m": list(payload.cog), "inertia_kg_m2": list(payload.inertia)},
        "force_bias": list(controller.arm.force_bias),
        "power": controller.power.state.name,
        "chances": controller.chances.save(),
        "world": None if controller.world is None else controller.world.save(),
        **{section: _values(holder(controller), names) for section, (holder, names) in _SECTIONS.items()},
    }


def journal_document(controller: "Controller", journal: bytes) -> dict[str, Any]:
    """The state at the end of a journal as a document."""
    return {**_kind(controller), "journal": b64encode(journal).decode()}


def check_document(controller: "Controller", document: Mapping[str, Any]) -> None:
    """Raises BadArguments for another robot's document."""
    for name, own in _kind(controller).items():
        if document.get(name) != own:
            raise BadArguments(f"the document's {name} is {document.get(name)!r}, that of this robot {own!r}")


def restore_state(controller: "Controller", document: Mapping[str, Any]) -> None:
    """Restore a state of plain values. Raises NotPossible, or BadArguments, without changing anything."""
    before = state_at_rest(controller)
    try:
        _apply(controller, document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        _apply(controller, before)
        raise BadArguments(f"the document is damaged: {type(error).__name__} {error}") from error


def check_rest(controller: "Controller") -> None:
    """Raises NotPossible while a program runs, the arm moves, or a stop is not released."""
    if controller.programs.state is not RuntimeState.STOPPED or controller.programs.busy:
        raise NotPossible("a program is running, whose state cannot be saved: stop it first")
    if controller.simulation.on:
        raise NotPossible("the robot is in simulation: switch to the real robot first")
    if not controller.motion.idle:
        raise NotPossible("the arm is moving: wait until it stands still")
    if controller.power.state not in _AT_REST:
        raise NotPossible(f"the arm is {controller.power.state.name}: wait until it is off, idle or running")
    if controller.safety.stopped:
        raise NotPossible(f"the safety mode is {controller.safety.mode.name}: release the stop first")


def _kind(controller: "Controller") -> dict[str, Any]:
    return {"format": _FORMAT, "model": controller.model.name, "series": controller.version.series.value}


def _apply(controller: "Controller", document: Mapping[str, Any]) -> None:
    power = PowerState[document["power"]]
    if power not in _AT_REST:
        raise ValueError(f"an arm cannot be put into {power.name}")
    payload = document["payload"]
    mounted = Payload(float(payload["mass_kg"]), _numbers(payload["cog_m"], 3), _numbers(payload["inertia_kg_m2"], 6))
    q = _numbers(document["q_rad"], 6)
    controller.motion.set_position(q)
    if controller.arm.drives is not None:
        controller.arm.recover(q)  # so that nothing of an earlier motion is left in it
    controller.set_tcp(_numbers(document["tcp"], 6))
    controller.installation.set_payload(mounted)
    controller.arm.restore_force(_numbers(document.get("force_bias", ZERO6), 6))
    for section, (holder, names) in _SECTIONS.items():
        target = holder(controller)
        for name in names:
            setattr(target, name, _like(getattr(target, name), document[section][name]))
    if (scene := document.get("world")) is not None:
        if controller.world is None:
            raise ValueError("it has a world with moving objects, this robot has none")
        controller.world.restore(scene)
    controller.chances.restore(document["chances"])
    controller.power.put(power)
    controller.electrics.mark()


def _values(holder: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: _plain(getattr(holder, name)) for name in names}


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, str):
        return readable(value)
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _like(present: Any, value: Any) -> Any:
    if isinstance(present, list | tuple):
        if len(value) != len(present):
            raise ValueError(f"expected {len(present)} values, found {len(value)}")
        values = [_like(own, new) for own, new in zip(present, value, strict=True)]
        return values if isinstance(present, list) else tuple(values)
    kind = type(present)
    if isinstance(present, bool) is not isinstance(value, bool):
        raise TypeError(f"{value!r} is not a {kind.__name__}")
    return kind(from_readable(value) if isinstance(value, str) else value)


def _numbers(values: Any, count: int) -> Any:
    if len(values) != count:
        raise ValueError(f"expected {count} numbers, found {len(values)}")
    return tuple(map(float, values))
