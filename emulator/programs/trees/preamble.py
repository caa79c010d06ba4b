"""What stands before every program: the settings and variables of the installation."""

from emulator.programs.trees.naming import identifier, quoted
from emulator.programs.trees.numbers import list_text, pose_text
from emulator.programs.trees.writer import Writer
from urproto.versions import Series

__all__ = ["write_preamble"]


def write_preamble(writer: Writer) -> None:
    """The installation as calls and variables, in the order of PolyScope's own scripts."""
    with writer.into("preamble"):
        if writer.installation.tcp is not None:
            _inputs_and_outputs(writer)
            _tool(writer)
        _modbus(writer)
    with writer.into("variables"):
        for name, value in writer.installation.variables.items():
            writer.line(f"global {identifier(name)}={value}")
        for name in sorted(writer.installation.feature_variables):
            writer.line(f"global {identifier(name)}={pose_text(writer.installation.features[name])}")


def _inputs_and_outputs(writer: Writer) -> None:
    file = writer.installation
    for port, domain in enumerate(file.analog_inputs):
        writer.line(f"set_standard_analog_input_domain({port}, {domain})")
    for port, domain in enumerate(file.tool_inputs):
        writer.line(f"set_tool_analog_input_domain({port}, {domain})")
    for port, domain in enumerate(file.analog_outputs):
        writer.line(f"set_analog_outputdomain({port}, {domain})")
    writer.line("set_input_actions_to_default()")


def _tool(writer: Writer) -> None:
    file = writer.installation
    if writer.version.series is Series.E:
        enabled, *serial = file.tool_serial
        writer.line(f"set_tool_communication({enabled}, {', '.join(map(str, serial))})")
        writer.line(f"set_tool_output_mode({file.tool_output_mode})")
        for port, kind in enumerate(file.tool_outputs):
            writer.line(f"set_tool_digital_output_mode({port}, {kind})")
    writer.line(f"set_tool_voltage({file.tool_voltage})")
    if file.tcp is not None:
        writer.line(f"set_tcp({pose_text(file.tcp)})")
    if file.payload is not None:
        writer.line(writer.payload(file.payload))
    if file.gravity is not None:
        writer.line(f"set_gravity({list_text(file.gravity)})")


def _modbus(writer: Writer) -> None:
    for signal in writer.installation.modbus:
        address, name = quoted(signal.address), quoted(signal.name)
        writer.line(f"modbus_add_signal({address}, {signal.slave}, {signal.register}, {signal.type}, {name}, False)")
        if signal.frequency >= 0:
            writer.line(f"modbus_set_signal_update_frequency({name}, {signal.frequency})")
