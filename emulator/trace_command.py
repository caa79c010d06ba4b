"""``ur-emulator trace``: a recorded run as a page, with the arm in 3D, a timeline and curves."""

import subprocess
import tempfile
from math import inf
from pathlib import Path
from typing import Annotated, Final

import typer

from emulator.journal.file import MAGIC
from emulator.journal.trace import trace_of
from urproto.commandline import application, fail
from urproto.compat import module_command
from urproto.trace.model import TraceError
from urproto.trace.page import make_page, packed, run_in

_PROGRAM: Final = "ur-emulator trace"

app = application(completion=False)


@app.command()
def _trace(
    file: Annotated[Path, typer.Argument(help="A journal, a recording (.mcap, .csv, .npz), or the page of either.")],
    *,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The page (default: FILE.html).")] = None,
    compare: Annotated[Path | None, typer.Option(help="A second such file: show its run over the first.")] = None,
    begin: Annotated[float, typer.Option("--from", metavar="SECONDS", help="Begin at this uptime.")] = 0.0,
    end: Annotated[float, typer.Option("--to", metavar="SECONDS", help="End at this uptime.")] = inf,
) -> None:
    """Show a recorded run as a page for browsers, which works without a network and a server."""
    try:
        typer.echo(make_page(file, output, compare, lambda one: _packed(one, begin, end)))
    except ValueError as error:
        fail(_PROGRAM, error)
    except OSError as error:
        fail(_PROGRAM, f"{error.filename or file}: {error.strerror}")


def _packed(file: Path, begin_s: float, end_s: float) -> str:
    with file.open("rb") as opened:
        if opened.read(len(MAGIC)) != MAGIC:
            return _recording(file, begin_s, end_s)
    trace, difference = trace_of(file, begin_s, end_s)
    if difference:
        typer.echo(f"{file}: {difference}", err=True)
    return packed(trace)


def _recording(file: Path, begin_s: float, end_s: float) -> str:
    """A recording, which the client reads: in a process of its own, as the emulator does not import the client."""
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder, "page.html")
        options = [f"--output={page}", f"--from={begin_s}", f"--to={end_s}"]
        words = [*module_command("client"), "trace", str(file), *options]
        done = subprocess.run(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace")
        if done.returncode:
            raise TraceError(done.stderr.strip().removeprefix("ur-client: "))
        typer.echo(done.stderr, err=True, nl=False)
        return run_in(page)
