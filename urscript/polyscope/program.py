"""Translate a program tree to URScript, and list its nodes as a pendant shows them."""

from dataclasses import dataclass
from typing import Final

from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.nodes import NODE_MODULES
from urscript.polyscope.numbers import identifier, list_text, pose_text, quoted, tag_in_words
from urscript.polyscope.registry import NODES, translate
from urscript.polyscope.starting import SKIPPING, StartingNode
from urscript.polyscope.tree import ProgramTree, TreeError
from urscript.polyscope.writer import ExternalControlCode, Writer, find_pin
from urscript.work import Steps

# kind of pin and its automatic action in PolyScope's words -> the call that sets it; START, STOP and PAUSE have none
_ACTIONS: Final = {
    ("digital_in", "FREEDRIVE"): 'set_standard_digital_input_action({0}, "freedrive")',
    ("config_in", "FREEDRIVE"): 'set_configurable_digital_input_action({0}, "freedrive")',
    ("tool_in", "FREEDRIVE"): 'set_tool_digital_input_action({0}, "freedrive")',
    ("GP_bool_in", "FREEDRIVE"): 'set_gp_boolean_input_action({0}, "freedrive")',
    ("digital_out", "LOW_WHEN_PROGRAM_STOPPED"): "set_runstate_standard_digital_output_to_value({0}, 1)",
    ("config_out", "LOW_WHEN_PROGRAM_STOPPED"): "set_runstate_configurable_digital_output_to_value({0}, 1)",
    ("tool_out", "LOW_WHEN_PROGRAM_STOPPED"): "set_runstate_tool_digital_output_to_value({0}, 1)",
    ("GP_bool_out", "LOW_WHEN_PROGRAM_STOPPED"): "set_runstate_gp_boolean_output_to_value({0}, 1)",
    ("analog_out", "LOW_WHEN_PROGRAM_STOPPED"): "set_runstate_standard_analog_output_to_value({0}, 1)",
}

_NODE_WORK: Final = 20  # guess [units of `urscript.work`]


def write_preamble(writer: Writer) -> None:
    """Write the installation as calls and variables, in the order of PolyScope's own scripts."""
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
        if writer.starting is not None:
            writer.line(f"global {SKIPPING}=True")


def _inputs_and_outputs(writer: Writer) -> None:
    file = writer.installation
    for port, domain in enumerate(file.analog_inputs):
        writer.line(f"set_standard_analog_input_domain({port}, {domain})")
    for port, domain in enumerate(file.tool_inputs):
        writer.line(f"set_tool_analog_input_domain({port}, {domain})")
    for port, domain in enumerate(file.analog_outputs):
        writer.line(f"set_analog_outputdomain({port}, {domain})")
    writer.line("set_input_actions_to_default()")
    for pin, action in file.actions.items():
        kind, number = find_pin(pin, {}) or ("", "")
        if (kind, action) in _ACTIONS:
            writer.line(_ACTIONS[kind, action].format(number))


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


assert NODES, NODE_MODULES  # importing the modules registers the nodes


def script_steps(
    tree: ProgramTree,
    installation: InstallationFile,
    *,
    version: PolyscopeVersion = DEFAULT_VERSION[Series.E],
    external_control: ExternalControlCode | None = None,
    start_at: int = 0,
) -> Steps[str]:
    """The URScript of a program, in pieces for a control loop. start_at: number of the node to begin at, 0 for all.

    Raises TreeError if the tree has nodes that cannot be run, or External Control nodes without code.
    """
    writer = yield from write_steps(
        tree, installation, version=version, external_control=external_control, start_at=start_at
    )
    return (yield from writer.text_steps())


def write_steps(
    tree: ProgramTree,
    installation: InstallationFile,
    *,
    version: PolyscopeVersion,
    external_control: ExternalControlCode | None,
    problems: list[tuple[Element, str]] | None = None,
    start_at: int = 0,
) -> Steps[Writer]:
    """Like `script_steps`, but returns the writer, which also has the labels of the nodes.

    problems: collects the problems of nodes, which then do not raise an error.
    """
    starting = StartingNode(tree, start_at) if start_at else None
    writer = Writer(tree, installation, version, external_control, problems, starting)
    children = tree.root.child("children")
    assert children is not None
    try:
        write_preamble(writer)
        for child in children:
            yield from translate(writer, child)
        writer.write_timers()
    except DocumentError as error:
        raise TreeError(f"{tree.name}: {error}") from error
    return writer


@dataclass(frozen=True, slots=True)
class OutlineNode:
    """A node of the outline. number: its line in the tree, as used in labels. suppressed: it is not executed."""

    number: int
    depth: int
    text: str
    suppressed: bool = False


def outline_steps(
    tree: ProgramTree, installation: InstallationFile, version: PolyscopeVersion
) -> Steps[list[OutlineNode]]:
    """All nodes in order, in pieces for a control loop. Raises TreeError for a tree that cannot be run."""
    writer = yield from write_steps(tree, installation, version=version, external_control=ExternalControlCode("", ""))
    nodes = list[OutlineNode]()
    for line in tree.lines:
        text = writer.labels.get(line.number) or _name(line.element)
        nodes.append(OutlineNode(line.number, line.depth, text, line.suppressed))
        yield _NODE_WORK
    return nodes


def _name(element: Element) -> str:
    """The name of a node without a label: its own, or that of its kind."""
    kind, named = element.tag, element
    if element.tag == "SuppressedNode" and (inner := element.child("suppressedNode")) is not None:
        kind, named = inner.get("class") or kind, inner
    return named.attributes.get("name") or tag_in_words(kind)
