"""One version of a text in an editor: its tokens and names, what the checker finds, and what a name means."""

import re
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Final

from urproto.text import to_bytes
from urproto.versions import PolyscopeVersion
from urscript.blocks import Blocks
from urscript.builtins import Builtin
from urscript.check.checking import Finding, findings
from urscript.check.project import Project
from urscript.check.rules.variables import type_in_words
from urscript.check.signatures import libraries, result_word
from urscript.check.sources import SCRIPTS, script_file, sources_in
from urscript.editor.symbols import Occurrence, Scope, Symbols
from urscript.editor.text import Places
from urscript.errors import CompileError
from urscript.files import ScriptFile
from urscript.inference import Kinds, infer_kinds
from urscript.syntax import Program
from urscript.tokens import Token
from urscript.work import run_to_end

LARGEST: Final = 1 << 20
"""Longest text that is analysed [characters], some twenty times the usual."""

_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_PLACE: Final = attrgetter("line", "column")


@dataclass(eq=False)
class Document:
    """A text and its project. versions: those it is checked for; the first one decides what is offered.

    blocks: those of its earlier states. number: of its state, if the editor counts them.
    """

    path: Path
    text: str
    project: Project
    versions: Sequence[PolyscopeVersion]
    blocks: Blocks = field(default_factory=Blocks)
    number: int | None = None

    def __post_init__(self) -> None:
        self.blocks.next_text()
        self.text = _SURROGATE.sub("\ufffd", self.text) if len(self.text) <= LARGEST else ""  # of the same width

    # names

    @cached_property
    def places(self) -> Places:
        """Where its lines are."""
        return Places(self.text)

    @cached_property
    def tokens(self) -> list[Token]:
        """Its tokens; only the last one if one is too long."""
        try:
            return self.blocks.tokens(self.text)
        except CompileError:
            return self.blocks.tokens("")

    @cached_property
    def script(self) -> ScriptFile:
        """Its programs."""
        return script_file(str(self.path.with_suffix(SCRIPTS[0])), to_bytes(self.text))

    @cached_property
    def symbols(self) -> Symbols:
        """Its scopes and names."""
        return Symbols(self.tokens, inlined=self.script.inlined)

    @property
    def builtins(self) -> dict[str, Builtin]:
        """The built-ins of its version."""
        return dict(libraries().available(self.versions[0]))

    def span(self, token: int) -> tuple[int, int]:
        """The offsets at which a token begins and ends."""
        start = self.places.start(self.tokens[token])
        return start, start + len(self.tokens[token].text)

    def token_at(self, offset: int) -> int:
        """The index of the token at or directly before an offset, or else of the next one."""
        line = self.places.line(offset)
        column = offset - self.places.offset(line, 1) + 1
        after = bisect_right(self.tokens, (line, column), key=_PLACE)
        inside = after > 0 and self.span(after - 1)[1] >= offset
        return after - 1 if inside else min(after, len(self.tokens) - 1)

    def is_code(self, offset: int) -> bool:
        """Whether a name can be typed at an offset: it is in no string, number or comment."""
        at = self.token_at(offset)
        start, end = self.span(at)
        if start < offset <= end:
            kind = self.tokens[at].kind
            return kind != "number" and (kind != "string" or offset == end)
        before = self.span(at - 1)[1] if at else 0
        return "#" not in self.text[max(before, self.text.rfind("\n", 0, offset)) : offset]

    def name_at(self, offset: int) -> Occurrence | None:
        """The name at or directly before an offset."""
        at = self.token_at(offset)
        for token in (at, at - 1):
            if (
                token >= 0
                and self.tokens[token].kind == "name"
                and self.span(token)[0] <= offset <= self.span(token)[1]
            ):
                return self.symbols.at_token(token)
        return None

    # what the checker finds

    def findings(self) -> list[Finding]:
        """All findings. Raises SourceError and ProjectError."""
        data, name = to_bytes(self.text), str(self.path.with_suffix(SCRIPTS[0]))
        sources = {version: sources_in(name, data, self.project, version) for version in self.versions}
        return findings(sources, self.project, blocks=self.blocks)

    def first_token(self, finding: Finding) -> int:
        """The index of the token at a finding, or else of the next one."""
        return min(bisect_left(self.tokens, (finding.line, finding.column), key=_PLACE), len(self.tokens) - 1)

    def shown(self, finding: Finding) -> tuple[int, int]:
        """The offsets between which a finding is shown."""
        start = self.places.offset(finding.line, finding.column)
        at, end = self.span(self.first_token(finding))
        return start, end if at == start < end else min(start + 1, len(self.text))

    # what a name means

    @cached_property
    def _inferred(self) -> list[tuple[Program, Kinds]]:
        found = []
        for unit in self.script.units:
            try:
                program = self.blocks.parse(unit.text, [])
                found.append((program, run_to_end(infer_kinds(program, self.builtins))))
            except (CompileError, RecursionError):
                continue
        return found

    def type_of(self, found: Occurrence) -> str:
        """The type of a variable in words; empty if it may have several."""
        for program, kinds in self._inferred:
            function = program.functions.get(found.scope.name)
            if function is not None or found.scope is found.scope.unit:
                return type_in_words(kinds.variable(function.scope if function else program.scope, found.name))
        return ""

    def signature(self, scope: Scope) -> str:
        """The header of a def or thread without the colon."""
        end = self.span(scope.first)[1]
        for at in range(scope.first, min(scope.last, scope.first + 400)):
            if self.tokens[at].kind == ":":
                break
            end = self.span(at)[1]
        return " ".join(self.text[self.span(scope.first)[0] : end].split())

    def comment_above(self, scope: Scope) -> str:
        """The comment directly above a def or thread."""
        lines = self.text[: self.span(scope.first)[0]].split("\n")[-21:-1]
        comment: list[str] = []
        while lines and lines[-1].lstrip().startswith("#"):
            comment.insert(0, lines.pop().strip().lstrip("#").strip())
        return "\n".join(comment)

    def about(self, found: Occurrence) -> str:
        """What there is to say about a name, as Markdown; empty if there is nothing."""
        key = self.symbols.key(found)
        builtin = self.builtins.get(found.of or found.name)
        if found.role in ("function", "argument") and builtin and not (key and self.symbols.defines(key)):
            return about_builtin(builtin)
        if key is None:
            return ""
        if key[1] == "function":
            scope = found.scope.unit.functions.get(found.name)
            return _markdown(self.signature(scope), self.comment_above(scope)) if scope else ""
        if not self.symbols.defines(key):
            return ""
        kind = self.type_of(found)
        owner = self.symbols.scopes[key[2]] if key[2] >= 0 else None
        where = f"a local variable of {owner.name}" if owner else "a global variable"
        if owner and found.name in owner.parameters:
            where = f"a parameter of {owner.name}"
        return _markdown(found.name, f"{where}: {kind}" if kind else where)


def about_builtin(builtin: Builtin) -> str:
    """The signature of a built-in, its result, the versions that have it, and what it does, as Markdown."""
    result = result_word(builtin)
    arrow = f" -> {result}" if result else ""
    return _markdown(f"{builtin.signature}{arrow}", builtin.doc, f"*{builtin.availability}*")


def _markdown(code: str, *paragraphs: str) -> str:
    return "\n\n".join([f"```urscript\n{code}\n```", *filter(None, paragraphs)])
