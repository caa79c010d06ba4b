"""What is found in a def depends on the def and on a few facts about the names in it: this module compares the facts.

The facts of a name are what the whole program says about it: whether it is a global variable, of which kind and with
which value; how the function of that name is called; which built-in has it. As long as a def is kept
(`urscript.blocks`) and its facts are the same, what was found in it still holds.
"""

from collections.abc import Callable, Hashable, Iterable
from typing import Any, TypeAlias

from urscript.compile_expressions import Unit
from urscript.errors import ScriptWarning
from urscript.inference import GLOBAL, RESULT
from urscript.syntax import Constant, FunctionDef, Kept, Name, Scope, parts

Facts: TypeAlias = tuple[Any, ...]


class Dependencies:
    """The facts of one program."""

    def __init__(self, unit: Unit) -> None:
        self._unit = unit
        self._has_handles = unit.has_handles
        self._facts: dict[str, Facts] = {}
        self._of_functions: dict[int, list[Any]] = {}  # by the id of their scopes

    def found(
        self,
        topic: Hashable,
        function: FunctionDef,
        find: Callable[[], Iterable[ScriptWarning]],
        more: Callable[[str], Any] | None = None,
    ) -> list[ScriptWarning]:
        """What `find` finds in a function, or found earlier; its lines become those of the program.

        topic: what is looked for. more: a further fact about each name, on which that depends. Nothing is kept if a
        name is not defined or a call does not fit: such a report depends on all names, and on what did not parse.
        """
        if function.kept is None:
            return list(find())
        unit, kept, lines = self._unit, function.kept, function.lines_before
        facts = self._of_function(function.scope, kept)
        if more is not None:
            facts = [*facts, *map(more, kept.words)]
        key = topic, unit.version, id(function.scope)
        before, warnings = kept.found.get(key, (None, []))
        if before != facts:
            errors, misfits = len(unit.errors), unit.misfits
            warnings = list(find())
            if unit.misfits == misfits:
                kept.found[key] = facts, warnings
            for error in unit.errors[errors:]:
                error.line += lines
        return [ScriptWarning(w.message, w.line + lines, w.column, unit.source, w.kind) for w in warnings]

    def _of(self, name: str) -> Facts:
        """The facts of a name."""
        facts = self._facts.get(name)
        if facts is None:
            program, plan, kinds = self._unit.program, self._unit.plans.get(name), self._unit.kinds
            facts = self._facts[name] = (
                name in program.globals,
                plan and (plan.parameters, plan.is_thread),
                self._unit.builtins.get(name),
                kinds.known(GLOBAL, name),
                kinds.known(RESULT, name),
                self._values(name),
            )
        return facts

    def _values(self, name: str) -> list[Any]:
        """The value of a global that is assigned only once, and those of the globals in it.

        With the types of all constants, because 1 equals True.
        """
        values: list[Any] = []
        constants, seen = self._unit.kinds.constants, {name}
        waiting = [constants[name]] if name in constants else []
        while waiting:
            node = waiting.pop()
            values.append(node)
            inside = [node]
            while inside:
                node = inside.pop()
                inside += (part for group in parts(node) for part in group)
                if isinstance(node, Constant):
                    values.append(node.value.__class__)
                elif isinstance(node, Name) and node.name in constants and node.name not in seen:
                    seen.add(node.name)
                    waiting.append(constants[node.name])
        return values

    def _of_function(self, scope: Scope, kept: Kept) -> list[Any]:
        """The facts of all names in a def, and the kinds of its own variables, which depend on its calls."""
        facts = self._of_functions.get(id(scope))
        if facts is None:
            own = (self._unit.kinds.known(scope.name, name) for name in (*scope.locals, *scope.assigned))
            facts = self._of_functions[id(scope)] = [self._has_handles, *map(self._of, kept.words), *own]
        return facts
