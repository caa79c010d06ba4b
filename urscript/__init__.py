"""URScript: the language of Universal Robots controllers, without the robot.

``compile_script`` turns text into a program, ``Runtime`` runs it one control period at a time.
Built-ins come from libraries (`urscript.builtins`); those that need no robot are in
`urscript.library`. The names below are imported from their modules on first use.
"""

from typing import TYPE_CHECKING

from urproto.lazy import exports

if TYPE_CHECKING:
    from urscript.builtins import Builtin, Library, LibrarySet
    from urscript.compiler import CompiledProgram, compile_script
    from urscript.errors import CompileError, RuntimeFault, ScriptError, ScriptRuntimeError
    from urscript.runtime import Host, Runtime, ScriptThread
    from urscript.splitter import ScriptSplitter, Unit

__all__ = [
    "Builtin",
    "CompileError",
    "CompiledProgram",
    "Host",
    "Library",
    "LibrarySet",
    "Runtime",
    "RuntimeFault",
    "ScriptError",
    "ScriptRuntimeError",
    "ScriptSplitter",
    "ScriptThread",
    "Unit",
    "compile_script",
]

__getattr__, __dir__ = exports(
    globals(),
    {
        "urscript.builtins": ("Builtin", "Library", "LibrarySet"),
        "urscript.compiler": ("CompiledProgram", "compile_script"),
        "urscript.errors": ("CompileError", "RuntimeFault", "ScriptError", "ScriptRuntimeError"),
        "urscript.runtime": ("Host", "Runtime", "ScriptThread"),
        "urscript.splitter": ("ScriptSplitter", "Unit"),
    },
)
