"""The language server: what editors ask, answered from `urscript.editor.document`.

A handler converts places and nothing else. Editors send the whole text at each change, which spares keeping a copy in
step with theirs. The checker runs in a thread, one text at a time. What both read of a text is kept for the next one,
block by block (`urscript.blocks`).
"""

import asyncio
import gc
import logging
import os
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import wraps
from pathlib import Path
from typing import Any, Final, TypeAlias

from lsprotocol import types
from pygls.exceptions import JsonRpcException, JsonRpcInvalidParams
from pygls.lsp.server import LanguageServer
from pygls.protocol import LanguageServerProtocol
from pygls.uris import from_fs_path, to_fs_path

from urproto.entry import SUCCESS
from urscript.blocks import Blocks
from urscript.check.checking import Finding
from urscript.check.command import chosen_versions
from urscript.check.project import ProjectError, project_of
from urscript.check.signatures import libraries
from urscript.check.sources import MAX_BYTES, SCRIPTS, SourceError
from urscript.check.subject import by_polyscope
from urscript.editor.document import Document, about_builtin
from urscript.editor.fixes import Fix, fixes
from urscript.editor.formatter import formatted, syntax_error
from urscript.editor.symbols import Key, Occurrence, Scope, call_at
from urscript.methods import METHOD_HINTS
from urscript.tokens import KEYWORDS

_NAME: Final = "urscript"
_PAUSE_S: Final = 0.02  # after the last key, before a text is checked
_COLLECTED: Final = 50_000  # objects; a long text has as many, and a collection looks at all that are kept of it
_MOST_FILES: Final = 500  # of a project that are searched for a name
_TOKEN_TYPES: Final = ("function", "variable", "parameter", "property", "method")
_MODIFIERS: Final = ("declaration", "defaultLibrary")
_SHOWN_AS: Final = {"thread": "function", "argument": "parameter", "member": "property"}
_KINDS: Final = {
    "file": types.SymbolKind.File,
    "sec": types.SymbolKind.Module,
    "def": types.SymbolKind.Function,
    "thread": types.SymbolKind.Event,
}
_LEGEND: Final = types.SemanticTokensLegend(_TOKEN_TYPES, _MODIFIERS)
_SEVERITY: Final = {True: types.DiagnosticSeverity.Error, False: types.DiagnosticSeverity.Warning}
_log: Final = logging.getLogger(__name__)

Found: TypeAlias = tuple[str, Document, Occurrence]
"""A name in a file of the project, with its address."""


class _Protocol(LanguageServerProtocol):
    """Answers requests that cannot be read, too: an editor would wait for ever."""

    def structure_message(self, data: dict[str, Any]) -> Any:
        try:
            return super().structure_message(data)
        except JsonRpcException as error:
            if "id" in data and "method" in data:
                self._send_response(data["id"], error=error.to_response_error())
            raise


class Server(LanguageServer):
    """The documents that an editor has open, by their address, and what was last found in each."""

    def __init__(self, options: Namespace) -> None:
        super().__init__(_NAME, "1", types.TextDocumentSyncKind.Full, protocol_cls=_Protocol)
        self.options = options
        self.documents: dict[str, Document] = {}
        self.checked: dict[str, tuple[Document, list[Finding]]] = {}
        self.tasks: dict[str, asyncio.Task[None]] = {}
        self.checker = ThreadPoolExecutor(1)

    def read(self, uri: str, text: str, number: int | None = None) -> Document:
        """A document with the settings of its project. Raises ProjectError and ValueError."""
        path = Path(to_fs_path(uri) or "untitled.script")
        project = project_of(path.absolute().parent)
        before = self.documents.get(uri)
        blocks = before.blocks if before is not None and before.project is project else Blocks()
        return Document(path, text, project, chosen_versions(self.options, project), blocks, number)

    def open(self, uri: str, text: str, number: int | None) -> None:
        """Take a new text of a document, and check it a little later."""
        try:
            self.documents[uri] = self.read(uri, text, number)
        except (ProjectError, ValueError) as error:
            self.documents.pop(uri, None)
            self.publish(uri, None, [], str(error))
            return
        if uri in self.tasks:
            self.tasks[uri].cancel()
        self.tasks[uri] = asyncio.get_running_loop().create_task(self._check(uri, self.documents[uri]))

    def close(self, uri: str) -> None:
        """Forget a document."""
        for known in (self.documents, self.checked):
            known.pop(uri, None)
        if uri in self.tasks:
            self.tasks.pop(uri).cancel()
        self.publish(uri, None, [])

    async def _check(self, uri: str, document: Document) -> None:
        try:
            await asyncio.sleep(_PAUSE_S)
            found = await asyncio.get_running_loop().run_in_executor(self.checker, document.findings)
        except (SourceError, ProjectError) as error:
            self.publish(uri, document, [], str(error))
            return
        except Exception as error:
            _log.error("the check of %s failed: %s", document.path, _reason(error))
            return
        self.checked[uri] = document, found
        self.publish(uri, document, found)

    def publish(self, uri: str, document: Document | None, found: Iterable[Finding], problem: str = "") -> None:
        """Show findings, or one problem at the beginning of the text."""
        shown = [_diagnostic(document, one) for one in found] if document else []
        start = types.Range(types.Position(0, 0), types.Position(0, 0))
        if problem:
            shown = [types.Diagnostic(start, problem, types.DiagnosticSeverity.Error, source=_NAME)]
        number = document.number if document else None
        self.text_document_publish_diagnostics(types.PublishDiagnosticsParams(uri, shown, number))

    def related(self, document: Document) -> Iterator[tuple[str, Document]]:
        """All files of the document's project, as they are open, with their addresses; the document comes first."""
        by_path = {other.path: (uri, other) for uri, other in self.documents.items()}
        yield by_path[document.path]
        if document.project.path is None:
            return
        folder = document.project.path.parent
        files = (file for file in folder.rglob("*") if file.suffix in SCRIPTS and file != document.path)
        for _, file in zip(range(_MOST_FILES), files, strict=False):
            if file in by_path:
                yield by_path[file]
            elif file.stat().st_size <= MAX_BYTES:
                uri = from_fs_path(str(file)) or ""
                yield uri, self.read(uri, file.read_text(encoding="utf-8", errors="replace"))

    def places_of(self, document: Document, key: Key) -> Iterator[Found]:
        """Where a thing is defined or used, in all files of the project."""
        kind, name = key[1], key[3]
        mine = document.symbols.defines(key)
        shared = key[2] < 0 and (not mine or _is_included(document))
        for uri, other in self.related(document) if shared else [next(self.related(document))]:
            if other is document:
                found: Iterable[Occurrence] = document.symbols.uses(key)
            else:
                found = other.symbols.outside(kind, name, defined=_is_included(other))
            yield from ((uri, other, one) for one in found)


def _is_included(document: Document) -> bool:
    return document.project.matches(document.project.include, document.path)


def _reason(error: Exception) -> str:
    """An exception in one line, with its place."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    where = f" at {Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}" if trace else ""
    return f"{type(error).__name__}: {error}{where}".replace("\n", " ")


# places


def _range(document: Document, start: int, end: int) -> types.Range:
    return types.Range(*(types.Position(*document.places.place(offset)) for offset in (start, end)))


def _token_range(document: Document, token: int) -> types.Range:
    return _range(document, *document.span(token))


def _offset(document: Document, place: types.Position) -> int:
    return document.places.offset_of((place.line, place.character))


def _location(found: Found) -> types.Location:
    uri, document, one = found
    return types.Location(uri, _token_range(document, one.token))


def _diagnostic(document: Document, found: Finding) -> types.Diagnostic:
    shown = _range(document, *document.shown(found))
    return types.Diagnostic(shown, found.message, _SEVERITY[found.is_error], found.code, source=_NAME)


# handlers


def make_server(options: Namespace) -> Server:
    """A server with all its handlers. options: model and PolyScope version, as for `urscript.check.command`."""
    server = Server(options)

    def answers(method: str, settings: Any = None) -> Callable[[Callable[[Document, Any], Any]], None]:
        """Register a handler, called with the document of a request; an exception becomes one line of the log."""

        def register(handler: Callable[[Document, Any], Any]) -> None:
            @wraps(handler)
            def handle(params: Any) -> Any:
                document = server.documents.get(params.text_document.uri)
                try:
                    return handler(document, params) if document is not None else None
                except JsonRpcException:
                    raise
                except Exception as error:
                    _log.error("%s failed: %s", method, _reason(error))
                    return None

            server.feature(method, settings)(handle)

        return register

    @server.feature(types.TEXT_DOCUMENT_DID_OPEN)
    def opened(params: types.DidOpenTextDocumentParams) -> None:
        server.open(params.text_document.uri, params.text_document.text, params.text_document.version)

    @server.feature(types.TEXT_DOCUMENT_DID_CHANGE)
    def changed(params: types.DidChangeTextDocumentParams) -> None:
        server.open(params.text_document.uri, params.content_changes[-1].text, params.text_document.version)

    @server.feature(types.TEXT_DOCUMENT_DID_SAVE)
    def saved(params: types.DidSaveTextDocumentParams) -> None:
        project_of.cache_clear()  # a project file, or a script that one includes, may have changed
        for uri, document in list(server.documents.items()):
            server.open(uri, document.text, document.number)

    @server.feature(types.TEXT_DOCUMENT_DID_CLOSE)
    def closed(params: types.DidCloseTextDocumentParams) -> None:
        server.close(params.text_document.uri)

    @answers(types.TEXT_DOCUMENT_HOVER)
    def hover(document: Document, params: types.HoverParams) -> types.Hover | None:
        found = document.name_at(_offset(document, params.position))
        text = found and (document.about(found) or _about_elsewhere(server, document, found))
        shown = types.MarkupContent(types.MarkupKind.Markdown, text) if text else None
        return types.Hover(shown, _token_range(document, found.token)) if shown and found else None

    @answers(types.TEXT_DOCUMENT_DEFINITION)
    def definition(document: Document, params: types.DefinitionParams) -> list[types.Location]:
        found = document.name_at(_offset(document, params.position))
        return [_location(one) for one in _defined(server, document, found)]

    @answers(types.TEXT_DOCUMENT_REFERENCES)
    def references(document: Document, params: types.ReferenceParams) -> list[types.Location]:
        found = document.name_at(_offset(document, params.position))
        key = document.symbols.key(found) if found else None
        places = server.places_of(document, key) if key else []
        return [_location(one) for one in places if params.context.include_declaration or not one[2].defines]

    @answers(types.TEXT_DOCUMENT_PREPARE_RENAME)
    def can_rename(document: Document, params: types.PrepareRenameParams) -> types.Range | None:
        found = document.name_at(_offset(document, params.position))
        return _token_range(document, found.token) if found and _renamed(server, document, found, "") else None

    @answers(types.TEXT_DOCUMENT_RENAME, types.RenameOptions(prepare_provider=True))
    def rename(document: Document, params: types.RenameParams) -> types.WorkspaceEdit | None:
        found = document.name_at(_offset(document, params.position))
        return types.WorkspaceEdit(_renamed(server, document, found, params.new_name)) if found else None

    @answers(types.TEXT_DOCUMENT_DOCUMENT_SYMBOL)
    def outline(document: Document, params: types.DocumentSymbolParams) -> list[types.DocumentSymbol]:
        return list(_outline(document, document.symbols.scopes[0]))

    @answers(types.TEXT_DOCUMENT_FOLDING_RANGE)
    def folding(document: Document, params: types.FoldingRangeParams) -> list[types.FoldingRange]:
        rows = {document.tokens[b.first].line: document.tokens[b.last].line for b in document.symbols.blocks}
        return [types.FoldingRange(first - 1, last - 1) for first, last in sorted(rows.items()) if first < last]

    @answers(types.TEXT_DOCUMENT_SEMANTIC_TOKENS_FULL, _LEGEND)
    def colours(document: Document, params: types.SemanticTokensParams) -> types.SemanticTokens:
        return types.SemanticTokens(_colours(document))

    @answers(types.TEXT_DOCUMENT_SIGNATURE_HELP, types.SignatureHelpOptions(trigger_characters=["(", ","]))
    def signature(document: Document, params: types.SignatureHelpParams) -> types.SignatureHelp | None:
        return _signature(document, _offset(document, params.position))

    @answers(types.TEXT_DOCUMENT_COMPLETION, types.CompletionOptions(trigger_characters=["."], resolve_provider=True))
    def completion(document: Document, params: types.CompletionParams) -> list[types.CompletionItem]:
        return _completion(document, _offset(document, params.position))

    @server.feature(types.COMPLETION_ITEM_RESOLVE)
    def describe(item: types.CompletionItem) -> types.CompletionItem:
        builtin = libraries().builtins.get(item.label)
        if builtin is not None and item.kind == types.CompletionItemKind.Function:
            item.documentation = types.MarkupContent(types.MarkupKind.Markdown, about_builtin(builtin))
        return item

    @answers(types.TEXT_DOCUMENT_CODE_ACTION, types.CodeActionOptions([types.CodeActionKind.QuickFix]))
    def repairs(document: Document, params: types.CodeActionParams) -> list[types.CodeAction]:
        uri, lines = params.text_document.uri, range(params.range.start.line, params.range.end.line + 1)
        base, known = server.checked.get(uri, (None, []))
        near = [one for one in known if base is document and one.line - 1 in lines]
        return [_action(document, uri, found, fix) for found in near for fix in fixes(document, found)]

    @answers(types.TEXT_DOCUMENT_FORMATTING)
    def formatting(document: Document, params: types.DocumentFormattingParams) -> list[types.TextEdit] | None:
        if by_polyscope(document.text) or syntax_error(document.script) is not None:
            return None
        whole = _range(document, 0, len(document.text))
        return [types.TextEdit(whole, formatted(document.text))]

    return server


def _defined(server: Server, document: Document, found: Occurrence | None) -> list[Found]:
    key = document.symbols.key(found) if found else None
    return [one for one in server.places_of(document, key) if one[2].defines][:1] if key else []


def _about_elsewhere(server: Server, document: Document, found: Occurrence) -> str:
    return next((other.about(one) for _, other, one in _defined(server, document, found)), "")


def _renamed(server: Server, document: Document, found: Occurrence, name: str) -> dict[str, list[types.TextEdit]]:
    """The changes that give a thing another name. Raises JsonRpcInvalidParams for a name that it cannot have."""
    key = document.symbols.key(found)
    places = list(server.places_of(document, key)) if key else []
    if not any(one.defines for _, _, one in places):
        return {}
    if name and (not name.isidentifier() or not name.isascii() or name in KEYWORDS):
        raise JsonRpcInvalidParams(f"{name!r} cannot be a name")
    others = (one for _, other, _ in places for one in other.symbols.occurrences if other.symbols.key(one))
    if name and any(one.name == name for one in others):
        raise JsonRpcInvalidParams(f"{name!r} is in use")
    edits: dict[str, list[types.TextEdit]] = {}
    for uri, other, one in places:
        edits.setdefault(uri, []).append(types.TextEdit(_token_range(other, one.token), name))
    return edits


def _outline(document: Document, scope: Scope) -> Iterator[types.DocumentSymbol]:
    for inner in document.symbols.scopes:
        if inner.outer is scope and inner.name:
            whole = _range(document, document.span(inner.first)[0], document.span(inner.last)[1])
            name = _token_range(document, inner.first + 1)
            children = list(_outline(document, inner))
            yield types.DocumentSymbol(inner.name, _KINDS[inner.kind], whole, name, children=children)
    seen: set[str] = set()
    for found in document.symbols.occurrences if scope is scope.unit else ():
        if found.scope is scope and found.defines and found.role == "variable" and found.name not in seen:
            seen.add(found.name)
            place = _token_range(document, found.token)
            yield types.DocumentSymbol(found.name, types.SymbolKind.Variable, place, place)


def _colours(document: Document) -> list[int]:
    numbers: list[int] = []
    row = column = 0
    for found in document.symbols.occurrences:
        start, end = document.span(found.token)
        line, at = document.places.place(start)
        kind = _TOKEN_TYPES.index(_SHOWN_AS.get(found.role, found.role))
        builtin = found.role == "function" and found.name not in found.scope.unit.functions
        modifiers = found.defines | (builtin and found.name in libraries().builtins) << 1
        numbers += (line - row, at - column if line == row else at, end - start, kind, modifiers)
        row, column = line, at
    return numbers


def _callee(document: Document, at: int) -> tuple[str, list[str], str]:
    """The signature of a function that is called at a token, its parameters, and what it does."""
    name, scope = document.tokens[at].text, document.symbols.scope_at(at)
    own = scope.unit.functions.get(name)
    if own is not None:
        return document.signature(own).partition(" ")[2], own.parameters, document.comment_above(own)
    builtin = document.builtins.get(name)
    if builtin is not None:
        return builtin.signature, [parameter.text for parameter in builtin.parameters], builtin.doc
    return "", [], ""


def _signature(document: Document, offset: int) -> types.SignatureHelp | None:
    at = document.token_at(offset)
    call = call_at(document.tokens, at if document.span(at)[0] >= offset else at + 1)
    label, parameters, text = _callee(document, call[0]) if call else ("", [], "")
    if call is None or not label:
        return None
    shown = [types.ParameterInformation(parameter) for parameter in parameters]
    return types.SignatureHelp([types.SignatureInformation(label, text, shown)], 0, call[1])


def _completion(document: Document, offset: int) -> list[types.CompletionItem]:
    kinds, item = types.CompletionItemKind, types.CompletionItem
    at = document.token_at(offset)
    start, end = document.span(at)
    if not document.is_code(offset):
        return []
    at -= document.tokens[at].kind in ("name", *KEYWORDS) and start < offset <= end
    before = document.tokens[at].kind if document.span(at)[0] < offset else document.tokens[at - 1].kind if at else ""
    if before == ".":
        return [item(name, kind=kinds.Method) for name in METHOD_HINTS]
    scope = document.symbols.scope_at(at)
    functions = scope.unit.functions
    if before == "run":
        return [item(name, kind=kinds.Event) for name, one in functions.items() if one.kind == "thread"]
    call = call_at(document.tokens, at + 1)
    named = _callee(document, call[0])[1] if call else []
    names = [parameter.partition("=")[0] for parameter in named]
    known = document.project.known
    return [
        *(item(f"{name}=", kind=kinds.Field, sort_text=f" {name}") for name in names),
        *(item(name, kind=kinds.Variable) for name in sorted(scope.variables | set(known.variables))),
        *(item(n, kind=kinds.Function, detail=document.signature(one)) for n, one in functions.items() if n),
        *(item(name, kind=kinds.Function) for name in known.functions if name not in functions),
        *(item(b.name, kind=kinds.Function, detail=b.signature) for b in document.builtins.values()),
        *(item(word, kind=kinds.Keyword) for word in sorted(KEYWORDS)),
    ]


def _action(document: Document, uri: str, found: Finding, fix: Fix) -> types.CodeAction:
    edits = [types.TextEdit(_range(document, start, end), text) for start, end, text in fix.edits]
    return types.CodeAction(
        fix.title,
        types.CodeActionKind.QuickFix,
        [_diagnostic(document, found)],
        is_preferred=fix.likely,
        edit=types.WorkspaceEdit({uri: edits}),
    )


class _OneLine(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        """The message, and an exception without its traceback, in one line."""
        error = record.exc_info[1] if record.exc_info else None
        text = f"urscript lsp: {record.getMessage()}" + (f" ({error})" if error else "")
        return " ".join(text.split())[:1000]


def serve(options: Namespace) -> int:
    """Serve one editor on standard input and output; the exit status."""
    gc.freeze()  # what has been imported stays
    gc.set_threshold(_COLLECTED)
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(_OneLine())
    logging.basicConfig(handlers=[handler], level=logging.WARNING)
    make_server(options).start_io(stdout=os.fdopen(os.dup(sys.stdout.fileno()), "wb"))  # which it closes
    return SUCCESS
