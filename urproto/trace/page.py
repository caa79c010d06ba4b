"""Traces as pages: one HTML file each, which needs no network and no server.

A run is in the page as a script element with base64: of a zlib stream of the length of a JSON header (little-endian
uint32), the header, and the columns. A column is the bits of its float32 values as uint32, each minus the one before,
first the lowest byte of all of them, then the next, and so on: what changes smoothly becomes small. So a page is also
the file of its trace, from which another page takes the run that it compares with.
"""

import json
import re
import sys
import zlib
from array import array
from base64 import b64decode, b64encode
from collections.abc import Callable, Mapping, Sequence
from html import escape
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from struct import pack
from typing import Any, Final

from urproto.durable import write_file
from urproto.extras import how_to_install
from urproto.robots.calibration import chain_of
from urproto.robots.shapes import link_parts
from urproto.text import readable, readable_in
from urproto.trace import STATIC
from urproto.trace.model import CURVES, Entry, Trace, TraceError

_LIBRARY: Final = Path("elements", "scene", "dist", "index.js")  # three.js, in the package nicegui
_BITS: Final = next(code for code in "IL" if array(code).itemsize == 4)
_TICKS_PER_S: Final = 10_000  # of the times of samples
_RUN: Final = re.compile(r'<script id="run" type="text/plain">([A-Za-z0-9+/=]+)</script>')


def packed(trace: Trace) -> str:
    """A run as it is in a page. Raises TraceError if it is empty."""
    if not trace.times:
        raise TraceError(f"{trace.title} has no state to show")
    start_s = trace.times[0]
    ticks = array(_BITS, (round((time_s - start_s) * _TICKS_PER_S) for time_s in trace.times))
    columns = [array(_BITS, column.tobytes()) for columns in trace.columns.values() for column in columns]
    header = json.dumps(readable_in(_header(trace)), separators=(",", ":")).encode("ascii")
    content = b"".join((pack("<I", len(header)), header, *map(_differences, (ticks, *columns))))
    return b64encode(zlib.compress(content, 9)).decode("ascii")


def _differences(column: "array[int]") -> bytes:
    small = array(_BITS, [column[0], *((after - before) & 0xFFFFFFFF for before, after in pairwise(column))])
    if sys.byteorder == "big":
        small.byteswap()
    data = small.tobytes()
    return b"".join(data[place::4] for place in range(4))


def _header(trace: Trace) -> dict[str, Any]:
    model = trace.model
    chain = chain_of(model.calibration or model.dh) if model else ()
    return {
        "title": trace.title,
        "about": trace.about,
        "start": trace.times[0],
        "samples": len(trace.times),
        "columns": {name: len(columns) for name, columns in trace.columns.items()},
        "curves": [curves._asdict() for curves in CURVES],
        "lanes": [
            {"name": lane.name, "states": lane.states, "entries": [*map(_entry, lane.entries)]}
            for lane in trace.lanes.values()
        ],
        "programs": trace.programs,
        "objects": trace.objects,
        "reach": model.reach_m if model else 1.0,
        "chain": [[frame.position, frame.axes] for frame in chain],
        "links": [
            [[part.profile, part.origin, part.axis, part.color] for part in parts]
            for parts in (link_parts(model) if model else ())
        ],
    }


def _entry(entry: Entry) -> list[Any]:
    fields = [round(entry.time_s, 4), entry.text, entry.level, entry.detail, entry.place]
    while not fields[-1]:
        fields.pop()
    return fields


def run_in(page: Path) -> str:
    """The packed run of a page. Raises TraceError, OSError."""
    found = _RUN.search(page.read_text("utf-8", errors="replace"))
    try:
        zlib.decompress(b64decode(found[1] if found else ""))
    except (ValueError, zlib.error) as error:
        raise TraceError(f"{page} is not the page of a trace") from error
    return found[1] if found else ""


def make_page(file: Path, output: Path | None, compare: Path | None, pack: Callable[[Path], str]) -> str:
    """Write the page of a file, next to it by default, or of two to compare; returns what to say about it.

    pack: packs the run of a file that is not a page. Raises TraceError, OSError, and what pack raises.
    """
    runs = [run_in(one) if one.suffix == ".html" else pack(one) for one in (file, compare) if one is not None]
    path = output or file.with_name(f"{file.name}.html")
    write_page(path, file.name, *runs)
    return f"{path}: {path.stat().st_size / 1e6:.1f} MB"


def write_page(
    path: Path, title: str, run: str, other: str = "", *, above: str = "", details: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Write the page of a packed run, or of two to compare. Raises TraceError if three.js is missing, OSError.

    above: HTML to show above the runs. details: of each run, what replaces or adds to its header: its ``title``, and
    ``waypoints``, positions [m] to mark in its colour.
    """
    parts = {
        "title": escape(readable(title)),
        "style": _text("trace.css"),
        "above": above,
        "run": run,
        "other": other,
        "details": json.dumps(readable_in(list(details))).replace("<", "\\u003c"),
        "three": b64encode(zlib.compress(library(), 9)).decode("ascii"),
        "script": "\n".join(map(_text, ("curves.js", "shapes.js", "trace_scene.js", "trace.js"))),
    }
    page = re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], _text("trace.html"))
    write_file(path, page)


def library() -> bytes:
    """three.js, which draws the arm. Raises TraceError if it is not installed."""
    spec = find_spec("nicegui")
    if spec is None or not spec.submodule_search_locations:
        raise TraceError(
            f"the 3D view of a trace is drawn by a library of the extra pendant: {how_to_install('pendant')}"
        )
    return Path(spec.submodule_search_locations[0], _LIBRARY).read_bytes()


def _text(name: str) -> str:
    return (STATIC / name).read_text("utf-8")
