"""Conveyor encoders and conveyor tracking."""

import math

from emulator.builtins.geometry import OUT_OF_RANGE
from emulator.builtins.host import Frames, ProgramHost
from emulator.io.encoders import DecoderType, Encoder
from emulator.motion.superposition import Source
from emulator.motion.tracking import CircularConveyor, LinearConveyor
from urproto.vectors import as_six
from urproto.versions import Series
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Bool, Int, Num, PoseOrJoints, Str

LIBRARY = Library("conveyor", host=True, physical=True, faults=OUT_OF_RANGE)

# vendor's conveyor tracking guide: encoder_* and the second encoder came with these versions
_CB3, _E = "3.8", "5.2"
_SAMPLED = "inputs are sampled once a control period, so faster pulses are lost"
# Script Manual: digital inputs 0-3 on CB3, 8-11 on e-Series, where the old function still says 0-3. That 8-11 are the
# configurable inputs 0-3, as in the digital words, is a guess.
_PINS = {Series.CB3: (0, 1, 2, 3), Series.E: (0, 1, 2, 3, 8, 9, 10, 11)}


@LIBRARY.builtin(cb3=_CB3, e=_E, status="partial", note=_SAMPLED)
def encoder_enable_pulse_decode(
    host: ProgramHost, encoder_index: Int, decoder_type: Int, A: Int, B: Int | None = None
) -> None:
    """Count the pulses on the digital inputs `A` and `B` with encoder 0 or 1.

    `decoder_type`: 0 none, 1 quadrature (A before B counts up), 2 both edges of A, 3 rising edges of A,
    4 falling edges of A. Counting starts at 0. A call that repeats the present set-up changes nothing.
    """
    _decode(host, "encoder_enable_pulse_decode", encoder_index, decoder_type, A, B)


@LIBRARY.builtin(status="partial", note=_SAMPLED)
def conveyor_pulse_decode(host: ProgramHost, type_: Int, A: Int, B: Int | None = None) -> None:
    """Old name of encoder_enable_pulse_decode() for encoder 0."""
    _decode(host, "conveyor_pulse_decode", 0, type_, A, B)


@LIBRARY.builtin(cb3=_CB3, e=_E)
def encoder_enable_set_tick_count(host: ProgramHost, encoder_index: Int, range_id: Int) -> None:
    """Let encoder_set_tick_count() supply the count of encoder 0 or 1.

    `range_id`: 0 signed 32 bits; 1, 2, 3, 4 unsigned 8, 16, 24, 32 bits. Counts wrap around at the end of that range.
    """
    host.machine.encoders.expect_counts(encoder_index, range_id)


@LIBRARY.builtin(cb3=_CB3, e=_E)
def encoder_set_tick_count(host: ProgramHost, encoder_index: Int, count: Num) -> None:
    """Set the count of an encoder that the program reads itself; the first count is the encoder's start."""
    host.machine.encoders[encoder_index].feed(_whole("encoder_set_tick_count", count))


@LIBRARY.builtin()
def set_conveyor_tick_count(host: ProgramHost, tick_count: Num, absolute_encoder_resolution: Int = 0) -> None:
    """Old name of encoder_enable_set_tick_count() and encoder_set_tick_count() for encoder 0."""
    host.machine.encoders.expect_counts(0, absolute_encoder_resolution)
    host.machine.encoders[0].feed(_whole("set_conveyor_tick_count", tick_count))


@LIBRARY.builtin(cb3=_CB3, e=_E, note="filtered counts of an encoder fed by the program wrap around its own range")
def encoder_get_tick_count(host: ProgramHost, encoder_index: Int, opt: Str = "") -> float:
    """Interpolated count of encoder 0 or 1, 0 to 65536 when pulses are decoded; `opt` "raw" for the plain count."""
    encoder = host.machine.encoders[encoder_index]
    if opt not in ("", "raw"):
        raise RuntimeFault(f'encoder_get_tick_count: opt must be "" or "raw", not "{opt}"')
    return encoder.raw if opt == "raw" else encoder.count


@LIBRARY.builtin()
def get_conveyor_tick_count(host: ProgramHost) -> float:
    """Old name of encoder_get_tick_count() for encoder 0."""
    return host.machine.encoders[0].count


@LIBRARY.builtin(cb3=_CB3, e=_E)
def encoder_unwind_delta_tick_count(host: ProgramHost, encoder_index: Int, delta_tick_count: Num) -> float | None:
    """A difference of counts, corrected for a wrap-around in between; None while the encoder is not enabled."""
    encoder = host.machine.encoders[encoder_index]
    return float(encoder.unwound(delta_tick_count)) if encoder.enabled else None


@LIBRARY.builtin()
def track_conveyor_linear(
    host: ProgramHost, direction: PoseOrJoints, ticks_per_meter: Num, encoder_index: Int = 0
) -> None:
    """Move the arm, and all following movements, along with a conveyor.

    `direction`: its first three numbers, in the base frame; their length is ignored. Poses refer to the time
    when tracking began. Stays active until stop_conveyor_tracking() or the program's end.
    """
    name = "track_conveyor_linear"
    x, y, z = as_six(direction)[:3]
    if not 0.0 < math.hypot(x, y, z) < math.inf:
        raise RuntimeFault(f"{name}: direction must not be zero: give a pose whose x, y, z are not all 0")
    encoder = _checked(host, name, ticks_per_meter, encoder_index)
    _track(host, name, LinearConveyor(encoder, (x, y, z), float(ticks_per_meter)))


@LIBRARY.builtin()
def track_conveyor_circular(
    host: ProgramHost,
    center: PoseOrJoints,
    ticks_per_revolution: Num,
    rotate_tool: Bool = False,
    encoder_index: Int = 0,
) -> None:
    """Move the arm, and all following movements, along with a rotating conveyor.

    The conveyor rotates about the z axis of `center`, counter-clockwise for rising counts. `rotate_tool`: the
    tool rotates as well. See track_conveyor_linear().
    """
    name = "track_conveyor_circular"
    pose = as_six(center)
    if not all(map(math.isfinite, pose)):
        raise RuntimeFault(f"{name}: center must be a pose of finite numbers")
    encoder = _checked(host, name, ticks_per_revolution, encoder_index)
    _track(host, name, CircularConveyor(encoder, pose, float(ticks_per_revolution), rotate_tool=rotate_tool))


@LIBRARY.builtin()
def stop_conveyor_tracking(host: ProgramHost, a: Num = 20) -> Frames[None]:
    """Stop all joints with `a` [rad/s2] and end conveyor tracking: poses refer to the base frame again."""
    if not a > 0:
        raise RuntimeFault(f"stop_conveyor_tracking: a must be greater than 0, not {a}")
    with host.motion_control() as motion:
        yield from host.until_ready(motion.stop_tracking(a))


def _decode(host: ProgramHost, name: str, index: int, decoder_type: int, a: int, b: int | None) -> None:
    try:
        decoder = DecoderType(decoder_type)
    except ValueError:
        raise RuntimeFault(f"{name}: the decoder type must be 0 to 4, not {decoder_type}") from None
    pins = _PINS[host.machine.version.series]
    if decoder is DecoderType.QUADRATURE and (b is None or a == b):
        raise RuntimeFault(f"{name}: a quadrature encoder needs two inputs A and B")
    second = a if b is None or decoder is not DecoderType.QUADRATURE else b
    if decoder is not DecoderType.DISABLED and not {a, second} <= set(pins):
        raise RuntimeFault(f"{name}: A and B must be digital inputs {', '.join(map(str, pins))}, not {a} and {second}")
    host.machine.encoders.decode(index, decoder, a, second)


def _checked(host: ProgramHost, name: str, ticks: float, encoder_index: int) -> Encoder:
    if not math.isfinite(ticks) or ticks == 0:
        raise RuntimeFault(f"{name}: the number of ticks must be finite and other than 0, not {ticks}")
    return host.machine.encoders[encoder_index]


def _track(host: ProgramHost, name: str, conveyor: Source) -> None:
    host.check_main(name)
    host.motion.superposition.track(conveyor)


def _whole(name: str, count: float) -> int:
    if count != math.floor(count):
        raise RuntimeFault(f"{name}: the count must be a whole number, not {count}")
    return int(count)
