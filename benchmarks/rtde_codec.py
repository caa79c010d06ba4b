"""RTDE packages encoded and decoded per second, for a small recipe and the one ur_rtde asks for."""

import sys
import time
from collections.abc import Callable
from functools import partial

from table import Table

from emulator.controller import Controller, ControllerConfig
from urproto.robots import load_model
from urproto.rtde.codec import RTDEDecoder, decode_reply, output_packer
from urproto.rtde.fields import OUTPUT_FIELDS, available_fields
from urproto.rtde.recipes import Recipe

PACKAGES = 20_000
BLOCKS = 5
SMALL = ("timestamp", "actual_q", "robot_mode")
VECTORS = [name for name, field in OUTPUT_FIELDS.items() if field.type.wire_name == "VECTOR6D"]
SCALARS = [name for name, field in OUTPUT_FIELDS.items() if field.type.wire_name in ("DOUBLE", "UINT32", "INT32")]


def measure() -> Table:
    """Best block of each case."""
    controller = Controller(ControllerConfig(model=load_model("ur5e")))
    fields = available_fields(OUTPUT_FIELDS, controller.version)
    large = [name for name in VECTORS if name in fields][:18] + [name for name in SCALARS if name in fields][:40]
    rows = []
    for name, names in (("small", SMALL), ("large", tuple(large))):
        recipe = Recipe.of(names, fields)
        packer = output_packer(recipe, 2)
        package = packer(controller.snapshot)
        encode = _best(partial(packer, controller.snapshot))
        decode = _best(partial(_decode, package, recipe))
        rows.append([name, str(len(names)), f"{len(package)} B", *_columns(encode), *_columns(decode)])
    columns = ["recipe", "variables", "package", "encode", "packages/s", "decode", "packages/s"]
    return Table("RTDE codec", f"Best of {BLOCKS} blocks of {PACKAGES} data packages, one thread.", columns, rows)


def _decode(package: bytes, recipe: Recipe) -> tuple[object, ...]:
    (framed,) = RTDEDecoder().feed(package)
    return recipe.unpack(decode_reply(framed, 2).data)  # type: ignore[union-attr] # a data package


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
