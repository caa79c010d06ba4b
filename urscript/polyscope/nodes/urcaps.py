"""Program nodes contributed by URCaps."""

from typing import Final

from urproto.text import lines
from urscript.polyscope.document import Element, make
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.nodes.direction import write_direction_function
from urscript.polyscope.nodes.flow import count_time
from urscript.polyscope.nodes.motion import DIRECTION
from urscript.polyscope.registry import Kind, node
from urscript.polyscope.tree import EXTERNAL_CONTROL, TreeError, is_external_control
from urscript.polyscope.writer import Writer

_UNNAMED: Final = "192.168.56.1"  # the URCap's name for a driver that has none
OTHER_URCAP: Final = Kind(
    "urcap",
    "Another URCap's node",
    "URCaps",
    lambda element: element.get("strategyProgramNodeType"),
    contains="nodes",
)


def new_external_control(_: object = None) -> Element:
    """A new node as the URCap saves it; host and port are in the installation."""
    return make(
        "Contributed",
        make("dataModel"),
        strategyClass="com.fzi.externalcontrol.ExternalControlNode",
        strategyProgramNodeType=EXTERNAL_CONTROL,
        strategyURCapDeveloper="FZI Research Center for Information Technology",
        strategyURCapName=EXTERNAL_CONTROL,
    )


def _shown(installation: InstallationFile) -> str:
    page = installation.contributions.get(EXTERNAL_CONTROL, {})
    return f"Control by {page.get('name') or _UNNAMED}"


EXTERNAL_CONTROL_KIND: Final = Kind(
    "external_control",
    "External Control",
    "URCaps",
    lambda _: EXTERNAL_CONTROL,
    new=new_external_control,
    matches=is_external_control,
    shown_by=_shown,
)


@node(
    "Contributed",
    EXTERNAL_CONTROL_KIND,
    OTHER_URCAP,
    status="partial",
    note="External Control; others if the .script that PolyScope saved with the program contains their code",
)
def contributed(writer: Writer, element: Element) -> None:
    """Program node of a URCap."""
    if is_external_control(element):
        _external_control(writer, element)
        return
    urcap, kind = element.get("strategyURCapName"), element.get("strategyProgramNodeType")
    tree = writer.home(element)
    lines = tree.saved_script.code(writer.line_in(tree, element), urcap, kind)
    if lines is None:
        raise TreeError(
            f"the node {kind!r} belongs to the URCap {urcap!r}, which is not installed here: "
            f"save the program with PolyScope and put {tree.name}.script, which contains its code, next to it"
        )
    if tree.changed_since_saved:
        raise TreeError(
            f"the node {kind!r} belongs to the URCap {urcap!r}, whose code comes from {tree.name}.script, but the "
            f"program has changed since that was saved: {tree.changed_since_saved}: save it with PolyScope again"
        )
    writer.raw(lines)
    _prepare(writer, element)


def _prepare(writer: Writer, element: Element) -> None:
    """Write the functions and variables that the code of the nodes below uses, and that PolyScope writes elsewhere."""
    for inner in (child.resolved() for child in element.child("children") or ()):
        if inner.tag == "SuppressedNode":
            continue
        if inner.tag == "Waypoint" and inner.child("position") and inner.get("type") != "Relative":
            writer.waypoint(inner)
        elif inner.tag == DIRECTION:
            write_direction_function(writer)
        elif inner.tag == "Timer":
            count_time(writer, inner)
        _prepare(writer, inner)


def _external_control(writer: Writer, element: Element) -> None:
    """Write the header once, at the first node, and the rest at every node (seen in saved scripts)."""
    code = writer.external_control
    if code is None:
        raise TreeError("the program has External Control nodes, but no driver has provided their code")
    writer.label(element, _shown(writer.installation))
    if writer.once("external control header"):
        writer.raw(lines(code.header))
    writer.raw(lines(code.node))
