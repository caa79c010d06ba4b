"""The options of ``urscript format``, and its exit status."""

import difflib
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from urproto.durable import write_file
from urproto.entry import SUCCESS, TROUBLE, usage_error
from urproto.text import from_bytes, to_bytes
from urscript.check.project import project_of
from urscript.check.sources import SCRIPTS, SourceError, content
from urscript.check.subject import by_polyscope
from urscript.editor.formatter import formatted, syntax_error
from urscript.files import ScriptFile

HELP: Final = "indent and space script files in one way; the tokens of a program stay what they are"

_STDIN: Final = "-"


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="script file, or a folder of them; - reads a script from standard input and writes it to standard output",
    )
    parser.add_argument("--check", action="store_true", help="change nothing; the exit status is 1 if a file would be")
    parser.add_argument("--diff", action="store_true", help="likewise, and show the difference")
    parser.add_argument("--force", action="store_true", help="format scripts that PolyScope has written, too")


def run(options: Namespace) -> int:
    """Format the files; the exit status is 0, 1 for a file with a syntax error or, with --check or --diff, for one that
    would change, or 2 for wrong usage."""
    status = SUCCESS
    for name in options.files:
        for file in _files(name):
            try:
                status = max(status, _format(file, options))
            except (OSError, SourceError) as error:
                status = usage_error("urscript", f"{file}: {error.strerror}" if isinstance(error, OSError) else error)
    return status


def _files(name: str) -> Iterator[str]:
    path = Path(name)
    if name != _STDIN and path.is_dir():
        return (str(file) for file in sorted(path.rglob("*")) if file.suffix in SCRIPTS)
    return iter([name])


def _format(name: str, options: Namespace) -> int:
    if name == _STDIN:
        data = content("<stdin>", sys.stdin.buffer)
    else:
        with Path(name).open("rb") as file:
            data = content(name, file)
    text = from_bytes(data)
    reason, status = _reason_to_leave(name, data, force=options.force)
    result = text if reason else formatted(text)
    if reason:
        print(f"{name}: {reason}", file=sys.stderr)
    if options.diff:
        old, new = text.splitlines(keepends=True), result.splitlines(keepends=True)
        sys.stdout.writelines(difflib.unified_diff(old, new, name, name))
    elif name == _STDIN and not options.check:
        sys.stdout.buffer.write(to_bytes(result))
    if result == text or (name == _STDIN and not (options.check or options.diff)):
        return status
    if options.check or options.diff:
        print(f"{name}: would be formatted", file=sys.stderr)
        return TROUBLE
    write_file(Path(name), to_bytes(result))
    print(f"{name}: formatted", file=sys.stderr)
    return status


def _reason_to_leave(name: str, data: bytes, *, force: bool) -> tuple[str, int]:
    """Why a file stays as it is, and the exit status; no text if it can be formatted."""
    if by_polyscope(from_bytes(data)) and not force:
        return "left as it is, because PolyScope wrote it: --force formats it", SUCCESS
    error = syntax_error(ScriptFile(name, data))
    if error is None:
        return "", SUCCESS
    if error.is_open and name != _STDIN:  # a project may say that the rest follows
        path = Path(name).absolute()
        project = project_of(path.parent)
        if project.matches(project.open, path):
            return "", SUCCESS
    return f"not formatted: line {error.line}, column {error.column}: {error.message}", TROUBLE
