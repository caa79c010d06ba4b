"""What the compiler itself finds: errors, and calls that will fail."""

from typing import Final

from urscript.check.rules.registry import declare
from urscript.errors import CompileError, ScriptError, ScriptWarning

SYNTAX: Final = "URS001"
_UNKNOWN: Final = "URS002"
_OTHER_VERSION: Final = "URS003"
BROKEN_NODE: Final = "URS004"
STALE: Final = "URS108"
_ELSEWHERE: Final = "not available in PolyScope"

declare(SYNTAX, "syntax-error", "the text is not a URScript program", error=True)
declare(_UNKNOWN, "unknown-name", "a variable, function or thread is not defined", error=True)
declare(_OTHER_VERSION, "other-version", "a function is not available in this PolyScope version", error=True)
declare(BROKEN_NODE, "broken-node", "a node of a program tree cannot be translated to a script", error=True)

_MISTAKES: Final = {
    "arguments": ("URS101", "argument-count", "a call has too few or too many arguments, or an unknown one"),
    "type": ("URS102", "argument-type", "a literal argument has a wrong type"),
    "sum": ("URS103", "text-plus-number", "a text is added to something that is not a text"),
    "units": ("URS104", "units", "degrees where radians are due, or millimetres where metres are"),
    "escape": ("URS105", "escape", "a text contains \\n, \\r, \\t or \\0: URScript has no escapes"),
    "method": ("URS106", "list-method", "a list method is called that this PolyScope version lacks"),
}
"""The compiler's warnings: their kind, and the rule."""

for _code, _name, _summary in _MISTAKES.values():
    declare(_code, _name, _summary)

declare(STALE, "stale-script", "the script next to a program tree was saved from another state of the program")


def code_of(problem: ScriptError) -> str:
    """The rule of a problem that the compiler or a rule found."""
    if isinstance(problem, ScriptWarning):
        return _MISTAKES[problem.kind][0] if problem.kind in _MISTAKES else problem.kind
    if isinstance(problem, CompileError) and problem.unknown_name:
        return _OTHER_VERSION if _ELSEWHERE in problem.message else _UNKNOWN
    return SYNTAX
