"""What an RTDE input package does to the controller.

A ``*_mask`` names the bits of its companions that apply in the package that carries the
mask; a companion alone changes nothing until a mask comes (variables keep their last
value). Registers and the external wrench apply as they arrive.
"""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from emulator.guard import plausible
from urproto.modes import AnalogDomain, RuntimeState
from urproto.rtde.fields import INPUT_FIELDS, Field
from urproto.rtde.types import FieldType
from urproto.signals import DIGITAL_GROUPS, DigitalGroup

if TYPE_CHECKING:
    from emulator.controller import Controller


class InputActions:
    """Which inputs trigger freedrive. They outlive the program that said so, as the installation's do.

    While one of them is high, no program runs and the arm may move, the arm is in freedrive.
    """

    def __init__(self) -> None:
        self._levels: dict[tuple[str, int | str], Callable[[Controller], bool]] = {}
        self._free = False

    @property
    def free(self) -> bool:
        """True while an input holds the arm in freedrive."""
        return self._free

    def watch_digital(self, group: DigitalGroup, index: int) -> None:
        """Freedrive by a digital input. Raises IndexError for one the group does not have."""
        group.bit(index)
        self._levels[group.name, index] = lambda controller: controller.signals.get_digital_input(group, index)

    def watch_register(self, index: int) -> None:
        """Freedrive by a boolean input register."""
        self._levels["register", index] = lambda controller: controller.registers.input.get_bit(index)

    def watch_signal(self, name: str) -> None:
        """Freedrive by a Modbus signal; one that was deleted, or whose unit does not answer, counts as low."""
        self._levels["modbus", name] = lambda controller: controller.programs.modbus.is_high(name)

    def hold_button(self) -> None:
        """Freedrive for as long as the pendant's button is held: until it is forgotten."""
        self._levels["button", 0] = lambda _: True

    def forget(self, kind: str, index: int | str) -> None:
        """The input triggers nothing. ``kind``: the group's name, "register", "modbus" or "button"."""
        self._levels.pop((kind, index), None)

    def clear(self) -> None:
        """No input triggers anything."""
        self._levels.clear()

    def advance(self, controller: "Controller") -> None:
        """One control period, before programs run."""
        if not (self._levels or self._free):
            return
        allowed = controller.may_run and controller.programs.state is RuntimeState.STOPPED
        wanted = allowed and any(high(controller) for high in self._levels.values())
        if wanted and not self._free:
            controller.motion.freedrive()
            self._free = True
        elif not wanted:
            self.release(controller)

    def release(self, controller: "Controller") -> None:
        """Leave freedrive, if an input brought the arm there: a program takes over."""
        if self._free:
            controller.motion.end_freedrive()
            self._free = False


_Setter = Callable[["Controller", Any], None]


def apply_inputs(controller: "Controller", values: Mapping[str, Any]) -> None:
    """Apply one package; every variable in it counts as refreshed in this period.

    A value that is no number, or of no use for what it sets, is refused: the variable keeps its last one (guess).
    Raises KeyError for a name that is no input variable; nothing has changed then.
    """
    if strange := values.keys() - _SETTERS.keys():
        raise KeyError(f"no input variables: {', '.join(sorted(strange))}")
    controller.rtde_refreshed.update(dict.fromkeys(values, controller.step_count))
    usable = {name: value for name, value in values.items() if _usable(name, value)}
    for name in values.keys() - usable.keys() - controller.rtde_refused:
        controller.rtde_refused.add(name)
        controller.messages.note(f"RTDE input {name} = {values[name]} is refused (said once): it keeps its last value")
    controller.rtde_inputs.update(usable)
    for name, value in usable.items():
        _SETTERS[name](controller, value)


def _usable(name: str, value: Any) -> bool:
    if isinstance(value, float):
        return isfinite(value) if INPUT_FIELDS[name].index is not None else plausible(value)
    return not isinstance(value, tuple | list) or plausible(*value)


def _keep(controller: "Controller", value: Any) -> None:
    """A companion of a mask: kept in ``rtde_inputs`` until its mask selects it."""


def _speed_slider(controller: "Controller", mask: int) -> None:
    if mask & 1:
        controller.speed.set_slider(controller.rtde_inputs.get("speed_slider_fraction", 0.0))


def _digital(group: DigitalGroup) -> _Setter:
    levels_name = f"{group.name}_digital_output"

    def set_outputs(controller: "Controller", mask: int) -> None:
        controller.signals.apply_outputs(group, mask, controller.rtde_inputs.get(levels_name, 0))

    return set_outputs


def _analog(controller: "Controller", mask: int) -> None:
    domains = controller.rtde_inputs.get("standard_analog_output_type", 0)
    for index in (0, 1):
        if mask >> index & 1:
            controller.signals.analog_output_domains[index] = AnalogDomain(domains >> index & 1)
            ratio = controller.rtde_inputs.get(f"standard_analog_output_{index}", 0.0)
            controller.signals.set_analog_output(index, ratio)


def _external_wrench(controller: "Controller", wrench: Any) -> None:
    x, y, z, rx, ry, rz = wrench
    controller.ft_input.wrench_flange = (x, y, z, rx, ry, rz)


def _register(field: Field) -> _Setter:
    index = field.index
    assert index is not None
    if field.attribute == "input_int_registers":
        return lambda controller, value: controller.registers.input.set_int(index, value)
    if field.attribute == "input_double_registers":
        return lambda controller, value: controller.registers.input.set_double(index, value)
    if field.type is FieldType.BOOL:
        return lambda controller, value: controller.registers.input.set_bit(index, value)
    return lambda controller, value: controller.registers.input.set_bits(index, 32, value)


_SETTERS: Final[dict[str, _Setter]] = {
    **{name: _register(field) for name, field in INPUT_FIELDS.items() if field.index is not None},
    **{f"{group.name}_digital_output_mask": _digital(group) for group in DIGITAL_GROUPS},
    **{f"{group.name}_digital_output": _keep for group in DIGITAL_GROUPS},
    "speed_slider_mask": _speed_slider,
    "speed_slider_fraction": _keep,
    "standard_analog_output_mask": _analog,
    "standard_analog_output_type": _keep,
    "standard_analog_output_0": _keep,
    "standard_analog_output_1": _keep,
    "external_force_torque": _external_wrench,
}
