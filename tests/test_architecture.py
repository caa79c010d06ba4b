"""The structure of the code: imports between parts, no cycles, where time and sockets may be used."""

import ast
import re
import runpy
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import pytest

from tests.sources import PACKAGES, ROOT, module_path, modules, nodes, syntax_tree

pytestmark = pytest.mark.xdist_group("architecture")  # each worker would have to read every module

LAYERS = runpy.run_path(str(Path(__file__).with_name("layers.py")))
IMPORT_FUNCTIONS = {"import_module", "__import__", "load_from"}

CODE = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef

TESTING = "urproto.testing"

# package -> the project's packages it may import
MAY_IMPORT = {
    "urproto": {"urproto"},
    "urscript": {"urscript", "urproto"},
    "emulator": {"emulator", "urproto", "urscript"},
    "client": {"client", "urproto", "urscript"},
    TESTING: {"emulator", "urproto", "urscript"},  # starts emulators, so it stands above all of them
}
# third-party package -> the parts of the project that may import it
THIRD_PARTY = {
    "pygls": ("urscript.editor.server",),
    "lsprotocol": ("urscript.editor.server",),
    "em": ("client.ros2.message_builder",),
    "rosidl_parser": ("client.ros2.message_builder",),
    "rclpy": ("client.ros2",),
    "action_msgs": ("client.ros2",),
    "rcl_interfaces": ("client.ros2",),
    "geometry_msgs": ("client.ros2",),
    "std_msgs": ("client.ros2",),
    "std_srvs": ("client.ros2",),
    "lifecycle_msgs": ("client.ros2",),
    "diagnostic_msgs": ("client.ros2",),
    "coal": ("emulator.world.links", "client.planning"),
    "ompl": ("client.planning",),
    "h11": ("emulator.builtins.remote.connections", "emulator.servers.http", "client.robotapi"),
    "msgspec": (
        "emulator.control",
        "emulator.faults",
        "emulator.fleet",
        "emulator.robotapi",
        "emulator.servers.http",
        "emulator.campaign",
        "emulator.explore",
        "emulator.learning.task_file",
        "emulator.physics.description",
        "emulator.physics.file",
        "emulator.journal.values",
        "emulator.peers",
        "emulator.safety.files",
        "client.controllers.goal_files",
        "client.controllers.session",
        "urproto.structures",
        "urproto.worldfile",
    ),
    "mujoco": ("emulator.physics",),
    "PIL": ("emulator.physics.drawing", "emulator.evaluation.episodes", "client.lerobot"),
    "gymnasium": ("emulator.learning",),
    "lerobot": ("client.lerobot.devices",),
    "mcp": ("client.mcp",),
    "pyarrow": ("emulator.campaign.journal", "client.lerobot.dataset"),
    "ray": ("emulator.campaign.workers",),
    "fastapi": ("client.pendant.web_security", "client.pendant.live", "client.pendant.server"),
    "socketio": ("client.pendant.web_security",),
    "httpx": ("client.pendant.emulator_control", "client.pendant.cameras"),
    "nicegui": ("client.pendant",),
    "foxglove": ("client.recording.live",),
    "websockets": ("client.recording.live",),
    "matplotlib": ("client.recording.plots", "client.identification.fidelity"),
    "mcap": ("client.recording.mcapfile", "client.recording.pictures"),
    "numpy": (
        "emulator.physics",
        "emulator.learning",
        "urproto.robots.pinocchio_dynamics",
        "emulator.world.links",
        "client.cameras",
        "client.controllers.servo",
        "client.pendant.cameras",
        "client.pendant.jogging",
        "client.recording",
        "client.ros2.message_builder",
        "client.identification",
        "client.lerobot",
        "client.traffic",
        "client.planning",
    ),
    "pytest": ("urproto.testing.pytest_plugin",),
    "async_timeout": ("urproto.compat_asyncio",),
    "tomli": ("urproto.compat",),
    "typing_extensions": ("urproto.compat",),
    "pinocchio": ("urproto.robots.pinocchio_dynamics", "client.planning"),
    "yaml": (
        "urproto.structures",
        "client.calibration",
        "client.ros2.overlay",
        "client.identification.identify",
        "client.traffic.peers_file",
    ),
    "typer": (
        "emulator.check",
        "emulator.cli",
        "emulator.options",
        "emulator.ctl",
        "emulator.facts_command",
        "emulator.replay_command",
        "emulator.trace_command",
        "emulator.campaign.command",
        "emulator.evaluation.command",
        "emulator.explore.command",
        "emulator.fleet.command",
        "emulator.lockstep.command",
        "client.cli",
        "client.commands",
        "urproto.commandline",
    ),
    "rich": ("emulator", "client", "urproto.commandline"),
}
URSCRIPT_MAY_IMPORT = (
    "urproto.compat",
    "urproto.entry",
    "urproto.lazy",
    "urproto.facts",
    "urproto.robots.pose",
    "urproto.text",
    "urproto.versions",
)
# PolyScope's files contain poses and joint angles, and are saved
POLYSCOPE_MAY_IMPORT = (
    *URSCRIPT_MAY_IMPORT,
    "urproto.robots",
    "urproto.vectors",
    "urproto.durable",
    "urproto.structures",
)
EDITOR_MAY_IMPORT = (*URSCRIPT_MAY_IMPORT, "urproto.durable", "urproto.extras")
# the parts of `urscript` that the client may import: programs are created on the client's side too
CLIENT_MAY_IMPORT_OF_URSCRIPT = ("urscript.polyscope", "urscript.work")
# modules of the world outside the tick: only these parts of the emulator and of the client may use them
OUTSIDE_WORLD = {"asyncio", "http", "socket", "threading", "select", "time", "selectors", "datetime"}
MAY_ACCESS_OUTSIDE = (
    "emulator.clock",
    "emulator.logs",
    "emulator.realtime",
    "emulator.app",
    "emulator.cli",
    "emulator.options",
    "emulator.pendant_process",
    "emulator.script_run",
    "emulator.scripttest.runner",
    "emulator.serve",
    "emulator.replay_command",
    "emulator.readiness",
    "emulator.fleet.class_robot",
    "emulator.fleet.class_server",
    "emulator.fleet.worker",
    "emulator.campaign.work",
    "emulator.explore.command",
    "emulator.lockstep",
    "emulator.debugger.adapter",
    "urscript.editor.server",
    "emulator.campaign.command",
    "emulator.evaluation.command",
    "emulator.servers",
    "emulator.control.http",
    "emulator.check",
    "client",
    "urproto.addresses",
    "urproto.compat_asyncio",
    "urproto.durable",  # a thread, in which a control loop writes
    "urproto.robots.pinocchio_dynamics",  # a lock: any thread may read a snapshot
    "urproto.controlapi",
    "urproto.testing",
)
# a module of the standard library that imports sockets -> its names that may be used, which need assert_none
CODECS = {"xmlrpc": {"Fault", "Unmarshaller", "dumps", "loads"}}
LONGEST_FILE = 600
# functions that write a file, whatever they are a method of
FILE_WRITERS = {
    "write_text",
    "write_bytes",
    "mkstemp",
    "mkdtemp",
    "NamedTemporaryFile",
    "symlink_to",
    "savefig",
    "savez",
    "savez_compressed",
    "ParquetWriter",
    "write_table",
}
# module -> why it writes files without urproto.durable
WRITES_FILES = {
    "urproto.durable": "it is the one that may",
    "client.recording.plots": "matplotlib writes to memory",
    "client.recording.tables": "numpy writes to a file of urproto.durable",
    "emulator.debugger.adapter": "standard output, which nothing else of the process may write to",
    "urscript.editor.server": "likewise",
    "emulator.campaign.journal": "Parquet, likewise; and a journal grows: each line is flushed, and a torn one removed",
    "client.lerobot.dataset": "Parquet writes in a folder of urproto.durable",
    "emulator.reports": "archives in memory or in a file of urproto.durable, and their temporary folder",
    "emulator.lockstep.clock": "the memory that processes share, which is gone with them, and a compiled library",
    "emulator.physics.drawing": "pictures in memory, and the pipe to the robot",
    "emulator.programs.loading": "copies to a temporary folder, which has no earlier content",
    "client.pendant.saved": "renames an unreadable file",
    "client.tool_communication": "a link to a serial device",
    "client.controllers.serving": "locks, and an address that is gone with its process",
    "client.ros2.message_packages": "a cache, which is built again if its manifest does not fit",
    "client.ros2.message_builder": "likewise",
}


@cache
def imports(name: str, *, at_import_time: bool = False) -> frozenset[str]:
    """Absolute dotted names that a module imports; optionally only those executed on import."""
    return frozenset(_imports(name, at_import_time))


def _imports(name: str, at_import_time: bool) -> Iterator[str]:
    for node in _executed_on_import(syntax_tree(name)) if at_import_time else nodes(name):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: relative import; the project writes absolute ones"
            assert node.module is not None
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in _known() else node.module
        elif isinstance(node, ast.Call) and not at_import_time:
            yield from _imported_by_name(node)


def _imported_by_name(call: ast.Call) -> Iterator[str]:
    """The module whose name an import function gets as a string, ``module`` or ``module:name``."""
    function = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    if function in IMPORT_FUNCTIONS and call.args and isinstance(call.args[0], ast.Constant):
        yield str(call.args[0].value).partition(":")[0]


def _executed_on_import(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _executed_on_import(node)


@cache
def _known() -> frozenset[str]:
    return frozenset(modules())


def within(name: str, parts: tuple[str, ...]) -> bool:
    return any(name == part or name.startswith(f"{part}.") for part in parts)


def assert_none(problems: Iterable[str]) -> None:
    """Fail with all findings together: each rule is one test, regardless of the number of modules."""
    found = sorted(problems)
    assert not found, "\n".join(found)


def test_dependency_table() -> None:
    assert_none(
        f"{name} imports {imported}: {why}"
        for name in modules()
        for imported in imports(name)
        if (why := _not_allowed(name, imported))
    )


def _not_allowed(name: str, imported: str) -> str | None:
    """The reason why a module may not import another; None if it may."""
    package, top = TESTING if within(name, (TESTING,)) else name.split(".")[0], imported.split(".")[0]
    if top not in PACKAGES:
        known = top in sys.stdlib_module_names or within(name, THIRD_PARTY.get(top, ()))
        return None if known else "see THIRD_PARTY"
    if name == "urscript.__main__" and imported == "emulator.script_cli":  # the command runs programs too
        return None
    if top not in MAY_IMPORT[package] or (within(imported, (TESTING,)) and package not in (TESTING, "emulator")):
        return "see MAY_IMPORT"
    if package == "client" and top == "urscript" and not within(imported, CLIENT_MAY_IMPORT_OF_URSCRIPT):
        return "see CLIENT_MAY_IMPORT_OF_URSCRIPT"
    if package == "urscript" and top == "urproto":
        outer = within(name, ("urscript.polyscope", "urscript.check", "urscript.scripttest"))
        allowed = POLYSCOPE_MAY_IMPORT if outer else URSCRIPT_MAY_IMPORT
        allowed = EDITOR_MAY_IMPORT if within(name, ("urscript.editor",)) else allowed
        return None if within(imported, allowed) else "the language is independent of robots"
    if within(imported, ("urscript.editor",)) and not within(
        name, ("urscript.editor", "urscript.__main__", "emulator")
    ):
        return "the language and its checks know nothing of editors"
    if within(name, ("urscript.check", "urscript.editor")):  # programs of all kinds
        return None
    if within(imported, ("urscript.check",)) and package == "urscript" and name != "urscript.__main__":
        return "the language knows nothing of checks"
    if package == "urscript" and within(imported, ("urscript.polyscope",)) != within(name, ("urscript.polyscope",)):
        return None if within(imported, ("urscript.work",)) else "the language does not depend on PolyScope"
    return None


def test_emulator_levels() -> None:
    assert_none(_level_violations("emulator", LAYERS["EMULATOR_LEVELS"]))


def _level_violations(package: str, levels: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """Imports between a package's parts (its modules and folders) that do not lead to a lower level."""
    level = {part: number for number, parts in enumerate(levels) for part in parts}
    for name in modules():
        if name == package or name.split(".")[0] != package:
            continue
        part = name.split(".")[1]
        if part not in level:
            yield f"{name}: {part} has no level"
            continue
        for imported in imports(name):
            other = imported.split(".")[1] if imported.startswith(f"{package}.") else part
            if other != part and not level.get(other, len(levels)) < level[part]:
                yield f"{name} on level {level[part]} imports {imported} on level {level.get(other)}"


def test_only_the_io_shells_access_the_outside_world() -> None:
    inner = (name for name in modules() if not within(name, MAY_ACCESS_OUTSIDE))
    assert_none(
        f"{name} imports {imported}"
        for name in inner
        for imported in imports(name)
        if imported.split(".")[0] in OUTSIDE_WORLD
    )


def test_modules_that_import_sockets_are_used_only_for_their_codecs() -> None:
    assert_none(f"{name} imports {used}" for name in modules() for used in _beyond_the_codec(name))


def _beyond_the_codec(name: str) -> Iterator[str]:
    for node in nodes(name):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.split(".")[0] in CODECS)
        elif isinstance(node, ast.ImportFrom) and (top := (node.module or "").split(".")[0]) in CODECS:
            yield from ({alias.name for alias in node.names} - CODECS[top])


def test_importing_the_language_or_protocols_does_not_load_pinocchio() -> None:
    for name in modules():
        if "pinocchio" in imports(name, at_import_time=True):
            assert name in ("urproto.robots.pinocchio_dynamics", "client.planning.collision_model")


def test_no_import_cycles() -> None:
    """No module imports itself indirectly; imports for type checkers and inside functions count."""
    graph = {name: {i for i in imports(name) if i in _known() and i != name} for name in modules()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(f"import cycle: {' -> '.join(error.args[1])}")


def test_files_stay_short() -> None:
    lengths = {name: len(module_path(name).read_text().splitlines()) for name in modules()}
    assert_none(f"{name} has {lines} lines: split it" for name, lines in lengths.items() if lines > LONGEST_FILE)


def test_constants_stand_above_the_code() -> None:
    """Except those that need a class or function of their module."""
    assert_none(f"{name} defines {constant} below its code" for name in modules() for constant in _late_constants(name))


def _late_constants(name: str) -> Iterator[str]:
    body = syntax_tree(name).body
    code = next((i for i, node in enumerate(body) if isinstance(node, CODE)), len(body))
    own = {node.name for node in body if isinstance(node, CODE)}
    for node in body[code:]:
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            used = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
            for target in targets:
                if isinstance(target, ast.Name):
                    if target.id.isupper() and not used & own:
                        yield target.id
                    else:
                        own.add(target.id)


def test_only_one_module_chooses_the_encoding_of_foreign_text() -> None:
    handlers = {"surrogateescape", "backslashreplace"}
    for name in modules():
        used = {node.value for node in nodes(name) if isinstance(node, ast.Constant)} & handlers
        assert not used or name == "urproto.text", f"{name} decodes or encodes by itself: urproto.text does"


def test_files_are_written_by_one_module() -> None:
    """Everything else could leave half a file, or none, when the disk is full or the process is killed."""
    found = {name: set(_ways_to_write(nodes(name))) for name in modules()}
    assert_none(
        f"{name} writes a file with {way}: use urproto.durable"
        for name, ways in found.items()
        if not within(name, (*WRITES_FILES, "urproto.testing"))
        for way in ways
    )
    assert_none(
        f"{name} writes no files: take it out of WRITES_FILES"
        for name in WRITES_FILES
        if not any(ways for other, ways in found.items() if within(other, (name,)))
    )


def _ways_to_write(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        owner = getattr(node.func.value, "id", "") if isinstance(node.func, ast.Attribute) else ""
        opened = name in ("open", "fdopen", "ZipFile") and any(
            re.fullmatch(r"[wax]b?\+?|r\+b?|rb\+", part.value)
            for part in ast.walk(node)
            if isinstance(part, ast.Constant) and isinstance(part.value, str)
        )
        flags = (owner, name) == ("os", "open") and any("O_CREAT" in ast.dump(part) for part in node.args)
        moved = owner == "os" and name in ("replace", "rename", "link", "symlink")
        copied = owner == "shutil" and name.startswith(("copy", "move"))
        if opened or flags or moved or copied or name in FILE_WRITERS:
            yield f"{owner}.{name}".strip(".")


def test_exactly_these_packages() -> None:
    found = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert found - {"tests"} == set(PACKAGES)  # the tests are not installed


def test_every_module_is_imported() -> None:
    """A controller type, fault, node or screen in a module that is never imported would silently be missing."""
    used = {imported for name in modules() for imported in imports(name) if imported != name}
    texts = [(ROOT / "pyproject.toml").read_text(), *(module_path(name).read_text() for name in modules())]
    named = {match for text in texts for match in re.findall(r'"([a-z_.0-9]+)(?::\w+)?"', text)}  # imported when needed
    named |= {f"client.commands.{place}" for place in re.findall(r'"(\w+):\w+"', module_path("client.cli").read_text())}
    assert_none(
        f"nothing imports {name}: add it to the registry of its package, or delete it"
        for name in modules()
        if name not in used | named and not name.endswith("__main__") and not _is_package_of(name, used | named)
    )


def _is_package_of(name: str, used: set[str]) -> bool:
    return any(within(other, (name,)) for other in used)


# the inside of a package


def layers(package: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Violations of a package's table; imports inside functions and for type checkers count as well."""
    used: set[tuple[str, str]] = set()
    for name in (name for name in modules() if within(name, (package,))):
        part = _layer_of(name, table)
        if part is None:
            yield f"{name} is in no part of the table of `{package}`"
            continue
        for imported in (imported for imported in imports(name) if within(imported, (package,))):
            other = _layer_of(imported, table)
            if other is not None and other != part:
                used.add((part, other))
                if other not in table[part].may_import:
                    allowed = ", ".join(table[part].may_import) or "no other part"
                    yield f"{name} imports {imported}, of `{other}`: `{part}` may import {allowed}"
    for index, (part, layer) in enumerate(table.items()):
        for other in layer.may_import:
            if other not in list(table)[:index]:
                yield f"`{part}` may import `{other}`, which is not above it in the table: imports would be circular"
            elif (part, other) not in used:
                yield f"`{part}` may import `{other}` and does not: take it out of the table"


def _layer_of(name: str, table: Mapping[str, Any]) -> str | None:
    """The part with the longest prefix of a module's name; the bare package matches only its ``__init__``."""
    prefixes = {prefix: part for part, layer in table.items() for prefix in layer.modules}
    found = [prefix for prefix in prefixes if name == prefix or ("." in prefix and name.startswith(f"{prefix}."))]
    return prefixes[max(found, key=len)] if found else None


def test_layers_of_client() -> None:
    assert_none(layers("client", LAYERS["CLIENT_LAYERS"]))


def test_an_import_that_violates_the_layers_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also inside functions and for type checkers; the message has both modules and the rule."""
    source = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from client.robot import Robot\n"
    source += "def later():\n    from client.pendant import server\n    import_module('client.ros2.host')\n"
    planted = {"client.driver.points": list(ast.walk(ast.parse(source)))}
    monkeypatch.setattr(f"{__name__}.nodes", lambda name: planted.get(name, []))
    imports.cache_clear()
    try:
        found = [line for line in layers("client", LAYERS["CLIENT_LAYERS"]) if "client.driver.points" in line]
    finally:
        imports.cache_clear()
    assert sorted(found) == [
        "client.driver.points imports client.pendant.server, of `pendant`: `driver` may import ports",
        "client.driver.points imports client.robot, of `robot`: `driver` may import ports",
        "client.driver.points imports client.ros2.host, of `ros2`: `driver` may import ports",
    ]
