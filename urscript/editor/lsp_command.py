"""The options of ``urscript lsp``, and its start."""

from argparse import ArgumentParser, Namespace
from typing import Final

from urproto.entry import usage_error
from urproto.extras import how_to_install

HELP: Final = "serve editors: the Language Server Protocol on standard input and output"


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument("--model", help="arm whose series selects the version, for files without a project file")
    parser.add_argument("--polyscope", help="PolyScope version, or several, for files without a project file")


def run(options: Namespace) -> int:
    """Serve one editor; returns the exit status."""
    try:
        from urscript.editor import server  # here, because only this command needs pygls
    except ImportError as error:
        return usage_error("urscript", f"the language server lacks a package ({error}): {how_to_install('editor')}")
    return server.serve(options)
