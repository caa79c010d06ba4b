"""RTDE data packages encoded and decoded per second, for recipes of 3 and 60 variables, compared with bare struct."""

import struct
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial

from table import Table

from emulator.controller import Controller
from emulator.machine import ControllerConfig
from urproto.robots import load_model
from urproto.rtde.codec import RTDEDecoder, output_packer
from urproto.rtde.fields import OUTPUT_FIELDS, available_fields
from urproto.rtde.recipes import Recipe

PACKAGES = 20_000
BLOCKS = 5
SMALL = ("timestamp", "actual_q", "robot_mode")
VECTORS = [name for name, field in OUTPUT_FIELDS.items() if field.type.wire_name == "VECTOR6D"]
SCALARS = [name for name, field in OUTPUT_FIELDS.items() if field.type.count == 1]
VARIABLES = 60


def measure() -> Table:
    """Best block of each case."""
    controller = Controller(ControllerConfig(model=load_model("ur5e")))
    fields = available_fields(OUTPUT_FIELDS, controller.version)
    vectors, scalars = ([name for name in names if name in fields] for names in (VECTORS, SCALARS))
    large = (vectors[:18] + scalars)[:VARIABLES]
    rows = []
    for name, names in (("small", SMALL), ("large", tuple(large))):
        recipe = Recipe.of(names, fields)
        packer = output_packer(recipe, 2)
        package = packer(controller.snapshot)
        bare = struct.Struct(">xxxx" + "".join(field.type.layout for field in recipe.fields))  # head and recipe id
        times = (
            _best(partial(packer, controller.snapshot)),
            _best(partial(_decode, RTDEDecoder(), package, recipe)),
            _best(partial(bare.unpack, package)),
        )
        columns = [text for time_s in times for text in _columns(time_s)]
        rows.append([name, str(len(names)), f"{len(package)} B", *columns])
    heads = ["recipe", "variables", "package", "encode", "packages/s", "decode", "packages/s", "struct", "packages/s"]
    about = (
        f"Best of {BLOCKS} blocks of {PACKAGES} data packages, one thread. Decoding includes everything a client does, "
        "from the bytes of a segment to values by name. Struct only converts the same bytes to numbers."
    )
    return Table("RTDE codec", about, heads, rows)


def _decode(decoder: RTDEDecoder, segment: bytes, recipe: Recipe) -> Mapping[str, object]:
    (package,) = decoder.feed(segment)
    return recipe.values(package.payload, 1)


def _best(function: Callable[[], object]) -> float:
    """Seconds a call."""
    best = float("inf")
    for _ in range(BLOCKS):
        began = time.perf_counter()
        for _ in range(PACKAGES):
            function()
        best = min(best, time.perf_counter() - began)
    return best / PACKAGES


def _columns(seconds: float) -> tuple[str, str]:
    return f"{seconds * 1e6:.1f} us", f"{1 / seconds:,.0f}"


if __name__ == "__main__":
    sys.stdout.write(measure().markdown())
