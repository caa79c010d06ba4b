"""``ur-emulator ctl VERB [VALUE ...] [NAME=VALUE ...]``: call a verb of a running emulator from a shell.

The list of verbs comes from the emulator, so this works with any version of it.
"""

import json
from base64 import b64decode
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.table import Table
from rich.text import Text

from urproto.commandline import application, console, fail
from urproto.controlapi import BadArguments, ControlClient, NotPossible
from urproto.durable import write_file
from urproto.ports import CONTROL_API_PORT
from urproto.text import json_document, unknown

_FAILED: Final = 1
_WRITTEN: Final = ("save", "journal")
_PROGRAM: Final = "ur-emulator ctl"
_LONG: Final = ("tuple[", "list[", "Sequence[")  # types of several values

app = application(completion=False)


@app.command(context_settings={"ignore_unknown_options": True})
def _ctl(
    verb: Annotated[str | None, typer.Argument(help="Verb to call; without one, all verbs are listed.")] = None,
    values: Annotated[
        list[str] | None, typer.Argument(help="Arguments in order, or name=value; several numbers as 1,2,3.")
    ] = None,
    host: Annotated[
        str, typer.Option("--robot-ip", "--host", envvar="UR_ROBOT_IP", help="Address of the emulator.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port of the control API.")] = CONTROL_API_PORT,
    token: Annotated[str, typer.Option(envvar="UR_EMULATOR_TOKEN", help="Token of the control API.")] = "",
    file: Annotated[
        Path | None, typer.Option("--file", "-f", help="File that save and journal write, or restore reads.")
    ] = None,
) -> None:
    """Use the control API of a running emulator: inputs, buttons, faults, time. Results are JSON."""
    client = ControlClient(host, port, token, timeout_s=None)
    try:
        verbs = {entry["name"]: entry for entry in client.verbs()}
        if verb is None:
            console().print(_overview(verbs))
            return
        name = verb.replace("-", "_")
        if name not in verbs:
            raise BadArguments(unknown("verb", verb, verbs))
        result = client.call(name, _arguments(verbs[name], values or [], file))
        _show(result, file if name in _WRITTEN else None)
    except (BadArguments, OSError) as error:
        fail(_PROGRAM, error)
    except NotPossible as error:
        fail(_PROGRAM, error, _FAILED)
    finally:
        client.close()


def _overview(verbs: dict[str, dict[str, Any]]) -> Table:
    table = Table.grid(padding=(0, 2))
    for name, entry in verbs.items():
        words = [a["name"] if a["required"] else f"[{a['name']}]" for a in entry["arguments"]]
        words += ["[name=value ...]"] if entry.get("open") else []
        table.add_row(Text(" ".join((name, *words))), Text(entry["text"].partition("\n")[0]))
    return table


def _arguments(verb: dict[str, Any], words: Sequence[str], file: Path | None) -> dict[str, Any]:
    """The arguments by name, in the types that the verb expects. Raises BadArguments."""
    types = {argument["name"]: argument["type"] for argument in verb["arguments"]}
    given: dict[str, Any] = {}
    if verb["name"] == "restore" and file is not None:
        given["document"] = _read(file)
    free = [name for name in types if name not in given]
    for word in words:
        name, equals, value = word.partition("=")
        if equals and name not in types and verb.get("open"):
            given[name] = _value(value, "")
            continue
        if not equals or name not in types:
            if not free:
                raise BadArguments(f"{verb['name']} takes {len(types)} arguments: {', '.join(types) or 'none'}")
            name, value = free[0], word
        free = [other for other in free if other != name]
        given[name] = _value(value, types[name])
    return given


def _value(word: str, kind: str) -> Any:
    """A word of the command line as a JSON value."""
    if any(kind.startswith(prefix) for prefix in _LONG) and not word.startswith("["):
        return [_value(part, "") for part in word.split(",") if part]
    if kind == "str":
        return word
    try:
        return json_document(word)
    except ValueError:
        return {"on": True, "off": False}.get(word, word)


def _read(file: Path) -> Any:
    try:
        return json_document(file.read_text())
    except ValueError as error:
        raise BadArguments(f"{file} is not JSON: {error}") from error


def _show(result: Any, file: Path | None) -> None:
    if file is not None:
        write_file(file, b64decode(result) if isinstance(result, str) else json.dumps(result, indent=2) + "\n")
    elif result is not None:
        typer.echo(json.dumps(result, indent=2))
