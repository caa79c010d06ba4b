"""The findings of sources, for one PolyScope version or several."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import Final

from urproto.versions import PolyscopeVersion
from urscript.blocks import Blocks
from urscript.check.names import owner_of
from urscript.check.project import Project
from urscript.check.rules import RULES
from urscript.check.rules.registry import BROKEN_NODE, STALE, Rule, code_of
from urscript.check.signatures import libraries
from urscript.check.sources import Source
from urscript.check.subject import Body, Subject
from urscript.compile_expressions import Unit
from urscript.compiler import Known
from urscript.dependencies import Dependencies
from urscript.errors import CompileError, ScriptError, ScriptWarning
from urscript.syntax import Node

_COMMENT: Final = re.compile("#|//")
_IGNORE: Final = re.compile(r"\burscript:[ \t]{0,9}ignore(-file)?\[([\w, \t]{0,999})\]")
_HINTED: Final = "'%s' is not defined"


@dataclass(frozen=True, slots=True, order=True)
class Finding:
    """A violation of a rule. text: the line it is on; versions: those for which it holds."""

    file: str
    line: int
    column: int
    code: str
    message: str
    text: str = ""
    versions: tuple[PolyscopeVersion, ...] = ()

    @property
    def is_error(self) -> bool:
        """Whether a program with it does not start."""
        return RULES[self.code].error


def findings(
    sources: Mapping[PolyscopeVersion, Sequence[Source]],
    project: Project,
    *,
    only_stale: bool = False,
    blocks: Blocks | None = None,
) -> list[Finding]:
    """What is found in a file for each version, in the order of its text.

    only_stale: of a program tree, only what its saved script lacks, because that script is checked itself.
    blocks: those of earlier states of the file.
    """
    merged: dict[tuple[int, int, str], Finding] = {}
    for version, row in sources.items():
        for source in row:
            for found in chain(
                _stale(source, project), () if only_stale else _in_source(source, version, project, blocks)
            ):
                key = (found.line, found.column, found.code)
                known = merged.get(key, found)
                versions = known.versions if version in known.versions else (*known.versions, version)
                merged[key] = replace(known, versions=versions)
    return sorted(merged.values())


def _stale(source: Source, project: Project) -> Iterable[Finding]:
    for line, message in source.stale if project.selects(STALE) else ():
        yield Finding(source.name, line, 1, STALE, message)


def _in_source(source: Source, version: PolyscopeVersion, project: Project, blocks: Blocks | None) -> Iterable[Finding]:
    if source.broken_nodes:
        for line, message in source.broken_nodes if project.selects(BROKEN_NODE) else ():
            yield Finding(source.name, line, 1, BROKEN_NODE, message)
        return
    outside = project.known
    variables = {*outside.variables, *source.variables}
    known = Known(outside.functions, variables, {*outside.undecided, *source.placeholders})
    selected = [rule for rule in RULES.values() if project.selects(rule.code)]
    complete = not (source.script.inlined or source.open or source.placeholders or source.in_tests)

    def inspect(unit: Unit, dependencies: Dependencies) -> Iterable[ScriptWarning]:
        subject = Subject(unit, complete and unit.program.kind == "program" and bool(unit.program.body))
        yield from _broken(selected, subject, dependencies)

    problems = source.script.problems(libraries(in_tests=source.in_tests), version, known, inspect, blocks)
    in_file, by_line = _ignored(source.lines)
    for problem in problems:
        code, place = code_of(problem), source.place(problem.line, problem.column)
        if place is None or not project.selects(code) or _may_follow(problem, source):
            continue
        line, column, text = place
        if not code.startswith((*in_file, *by_line.get(line, ()))):
            yield Finding(source.name, line, column, code, _hinted(problem), text)


def _broken(rules: Sequence[Rule], subject: Subject, dependencies: Dependencies) -> Iterator[ScriptWarning]:
    """The violations of some rules."""
    in_body = [(rule.code, rule.find_in_body) for rule in rules if rule.find_in_body]
    topic = tuple(code for code, _ in in_body)

    def warning(code: str, node: Node, message: str) -> ScriptWarning:
        return ScriptWarning(message, node.line, node.column, subject.unit.source, code)

    def inside(body: Body) -> list[ScriptWarning]:
        return [warning(code, *found) for code, find in in_body for found in find(subject, body)]

    for rule in rules:
        for body, node, message in rule.find(subject) if rule.find else ():
            found = warning(rule.code, node, message)
            found.line += body.lines_before
            yield found
    for body in subject.bodies:
        if body.function is None:
            yield from inside(body)
        else:
            yield from dependencies.found(topic, body.function, partial(inside, body), subject.timing.functions.get)


def _may_follow(problem: ScriptError, source: Source) -> bool:
    """Whether what a problem lacks may follow in the rest of a program: of an open file, or of a literal's text."""
    if not isinstance(problem, CompileError):
        return False
    return (source.open and (problem.unknown_name or problem.is_open)) or (source.embedded and problem.is_open)


def _hinted(problem: ScriptError) -> str:
    """The message; for a function of a URCap, with what to write in the project file."""
    if isinstance(problem, CompileError) and problem.unknown_name:
        name = problem.missing_name
        owner = owner_of(name) if problem.message.startswith(f"function {_HINTED % name}") else ""
        if owner:
            return f'{problem.message}; where the URCap is installed, write urcaps = ["{owner}"] in the project file'
    return problem.message


def _ignored(lines: Iterable[str]) -> tuple[tuple[str, ...], dict[int, tuple[str, ...]]]:
    """The codes, or their beginnings, that comments leave out: in the whole file, and by line."""
    in_file: tuple[str, ...] = ()
    by_line: dict[int, tuple[str, ...]] = {}
    for number, line in enumerate(lines, 1):
        comment = _COMMENT.search(line) if "urscript:" in line else None
        for match in _IGNORE.finditer(line, comment.end()) if comment else ():
            codes = tuple(filter(None, (code.strip() for code in match[2].split(","))))
            if match[1]:
                in_file += codes
            else:
                by_line[number] = by_line.get(number, ()) + codes
    return in_file, by_line
