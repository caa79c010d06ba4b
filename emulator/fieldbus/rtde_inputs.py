"""The effect of an RTDE input package on the machine.

A ``*_mask`` selects the bits of its companion variables that take effect with the package that carries the mask. A
companion without its mask changes nothing; variables keep their last value, so a mask in a later package can select it.
Registers and the external wrench take effect when they arrive.
"""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any, Final

from emulator.machine import Machine
from emulator.snapshot import plausible
from urproto.modes import AnalogDomain
from urproto.rtde.fields import INPUT_FIELDS, Field, FieldType
from urproto.signals import DIGITAL_GROUPS, DigitalGroup

_Setter = Callable[[Machine, Any], None]


def apply_inputs(machine: Machine, values: Mapping[str, Any]) -> None:
    """Apply one package; every variable in it counts as refreshed in this period.

    A value that is not a finite number or not plausible for its variable is rejected: the variable keeps its last value
    (guess). Raises KeyError for a name that is not an input variable; nothing is changed then.
    """
    if unknown := values.keys() - _SETTERS.keys():
        raise KeyError(f"not RTDE input variables: {', '.join(sorted(unknown))}")
    machine.rtde_refreshed.update(dict.fromkeys(values, machine.step_count))
    usable = {name: value for name, value in values.items() if _usable(name, value)}
    for name in values.keys() - usable.keys() - machine.rtde_refused:
        machine.rtde_refused.add(name)
        machine.messages.note(f"RTDE input {name} = {values[name]} is rejected: it keeps its last value (logged once)")
    machine.rtde_inputs.update(usable)
    for name, value in usable.items():
        _SETTERS[name](machine, value)


def _usable(name: str, value: Any) -> bool:
    if isinstance(value, float):
        return isfinite(value) if INPUT_FIELDS[name].index is not None else plausible(value)
    return not isinstance(value, tuple | list) or plausible(*value)


def _keep(machine: Machine, value: Any) -> None:
    """Do nothing with a companion of a mask: its value is in ``rtde_inputs`` until the mask selects it."""


def _speed_slider(machine: Machine, mask: int) -> None:
    if mask & 1:
        machine.speed.set_slider(machine.rtde_inputs.get("speed_slider_fraction", 0.0))


def _digital(group: DigitalGroup) -> _Setter:
    levels_name = f"{group.name}_digital_output"

    def set_outputs(machine: Machine, mask: int) -> None:
        machine.signals.apply_outputs(group, mask, machine.rtde_inputs.get(levels_name, 0))

    return set_outputs


def _analog(machine: Machine, mask: int) -> None:
    domains = machine.rtde_inputs.get("standard_analog_output_type", 0)
    for index in (0, 1):
        if mask >> index & 1:
            machine.signals.analog_output_domains[index] = AnalogDomain(domains >> index & 1)
            ratio = machine.rtde_inputs.get(f"standard_analog_output_{index}", 0.0)
            machine.signals.set_analog_output(index, ratio)


def _external_wrench(machine: Machine, wrench: Any) -> None:
    x, y, z, rx, ry, rz = wrench
    machine.ft_input.wrench_flange = (x, y, z, rx, ry, rz)


def _register(field: Field) -> _Setter:
    index = field.index
    assert index is not None
    if field.attribute == "input_int_registers":
        return lambda machine, value: machine.registers.input.set_int(index, value)
    if field.attribute == "input_double_registers":
        return lambda machine, value: machine.registers.input.set_double(index, value)
    if field.type is FieldType.BOOL:
        return lambda machine, value: machine.registers.input.set_bit(index, value)
    return lambda machine, value: machine.registers.input.set_bits(index, 32, value)


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
