"""The two conveyor encoders: pulse counting, counts fed by a program, and filtering.

Pulses are counted from the digital inputs once per control period, so at most one edge per period is seen on an input
(a real controller decodes 40 kHz in hardware). ``simulated_speed`` stands for a conveyor that is not wired: its ticks
are counted as if the decoder had seen them.

Programs read, and conveyor tracking follows, the filtered count: ticks are interpolated, without lag behind a conveyor
at constant speed. That a real controller interpolates is in the Script Manual; how it does so is not.
"""

from math import exp
from typing import Final

from emulator.snapshot import Snapshot
from urproto.compat import IntEnum

# Script Manual, encoder_enable_set_tick_count: range_id -> lowest count, number of counts
RANGES: Final = ((-(2**31), 2**32), (0, 2**8), (0, 2**16), (0, 2**24), (0, 2**32))
_PULSE_RANGE: Final = RANGES[2]  # Script Manual, encoder_get_tick_count: filtered counts are 0 to 65536
_BANDWIDTH: Final = 20.0  # rad/s, of the filter (guess)
_SETTLED_TICKS: Final = 1e-4  # closer to the count and slower than this, the filter settles on it (guess)
_SETTLED_TICKS_S: Final = 1e-2
# change of the count from one pair of levels (A + 2 B) to another; A leading B counts up (guess); a simultaneous
# change of both is ambiguous and not counted
_QUADRATURE: Final = {
    (0b00, 0b01): 1, (0b01, 0b11): 1, (0b11, 0b10): 1, (0b10, 0b00): 1,
    (0b01, 0b00): -1, (0b11, 0b01): -1, (0b10, 0b11): -1, (0b00, 0b10): -1,
}  # fmt: skip


class DecoderType(IntEnum):
    """How the pulses on the inputs A and B are counted."""

    DISABLED = 0
    QUADRATURE = 1
    BOTH_EDGES = 2
    RISING = 3
    FALLING = 4


class Encoder:
    """One encoder. ``travel`` and ``speed``: filtered ticks since it was enabled, never wrapped, and ticks/s.

    ``simulated_speed``: ticks/s of the emulated conveyor, which a pulse decoder counts.
    """

    def __init__(self, period_s: float) -> None:
        self.simulated_speed = 0.0
        self.travel = 0.0
        self.speed = 0.0
        self._period = period_s
        decay = exp(-_BANDWIDTH * period_s)
        self._gains = (1.0 - decay**2, (1.0 - decay) ** 2 / period_s)  # critically damped
        self._decoder = DecoderType.DISABLED
        self._pins = (0, 0)
        self._levels = -1  # of the inputs one period ago; -1: unknown
        self._fraction = 0.0  # of a simulated tick
        self._range: tuple[int, int] | None = None  # lowest count, number of counts; None while disabled
        self._total = 0  # unwrapped count
        self._fed = False  # a program sets the count

    @property
    def enabled(self) -> bool:
        """Whether pulses are decoded, or a program feeds counts."""
        return self._range is not None

    @property
    def raw(self) -> int:
        """The unfiltered count as a signed 32-bit number."""
        return (self._total + 2**31) % 2**32 - 2**31

    @property
    def count(self) -> float:
        """The filtered count within the encoder's range."""
        low, size = self._range or _PULSE_RANGE
        return low + (self.travel - low) % size

    def decode(self, decoder: DecoderType, a: int, b: int) -> None:
        """Count pulses on these digital inputs. Counting restarts at 0 unless the set-up is unchanged (guess)."""
        if decoder is DecoderType.DISABLED:
            self._decoder, self._range, self.speed, self._fed = decoder, None, 0.0, False
        elif (decoder, (a, b), False) != (self._decoder, self._pins, self._fed):
            self._restart(_PULSE_RANGE, fed=False)
            self._decoder, self._pins, self._levels = decoder, (a, b), -1

    def expect_counts(self, range_id: int) -> None:
        """Accept counts from `feed`. Raises ValueError for an unknown range."""
        if not 0 <= range_id < len(RANGES):
            raise ValueError(f"there is no encoder range {range_id}: use 0 to {len(RANGES) - 1}")
        if not self._fed or self._range != RANGES[range_id]:
            self._restart(RANGES[range_id], fed=True)
            self._decoder, self._levels = DecoderType.DISABLED, -1

    def feed(self, count: int) -> None:
        """Feed a count; the first one is the start of counting. Raises ValueError outside the range."""
        if self._range is None or not self._fed:
            raise ValueError("the encoder does not expect counts: call encoder_enable_set_tick_count() first")
        low, size = self._range
        if not low <= count < low + size:
            raise ValueError(f"the count {count} is outside the encoder's range {low} to {low + size - 1}")
        if self._levels < 0:
            self._levels, self._total, self.travel, self.speed = 0, count, float(count), 0.0
        else:
            self._total += round(self.unwound(count - self._total))

    def unwound(self, delta: float) -> float:
        """A difference of counts, corrected for a wrap-around of the range. Raises ValueError while disabled."""
        if self._range is None:
            raise ValueError("the encoder is not enabled")
        size = self._range[1]
        return (delta + 0.5 * size) % size - 0.5 * size if abs(delta) > 0.5 * size else delta

    def advance(self, digital_inputs: int) -> None:
        if self._decoder is not DecoderType.DISABLED:
            self._total += self._edges(digital_inputs) + self._simulated()
        if self.speed != 0.0 or self.travel != self._total:
            self._filter()

    def _restart(self, span: tuple[int, int], *, fed: bool) -> None:
        self._range, self._fed = span, fed
        self._total, self.travel, self.speed, self._fraction = 0, 0.0, 0.0, 0.0

    def _edges(self, digital_inputs: int) -> int:
        a, b = self._pins
        levels = (digital_inputs >> a & 1) + 2 * (digital_inputs >> b & 1)
        before, self._levels = self._levels, levels
        if before in (-1, levels):
            return 0
        if self._decoder is DecoderType.QUADRATURE:
            return _QUADRATURE.get((before, levels), 0)
        change = (levels & 1) - (before & 1)
        wanted = {DecoderType.BOTH_EDGES: change != 0, DecoderType.RISING: change > 0, DecoderType.FALLING: change < 0}
        return int(wanted[self._decoder])

    def _simulated(self) -> int:
        """Whole ticks of the emulated conveyor; only quadrature decoding detects its direction."""
        speed = self.simulated_speed
        if speed == 0.0:
            return 0
        ahead = speed if self._decoder is DecoderType.QUADRATURE else abs(speed)
        self._fraction += ahead * self._period
        ticks = int(self._fraction // 1.0)
        self._fraction -= ticks
        return ticks

    def _filter(self) -> None:
        position_gain, speed_gain = self._gains
        self.travel += self.speed * self._period
        error = self._total - self.travel
        self.travel += position_gain * error
        self.speed += speed_gain * error
        if abs(error) < _SETTLED_TICKS and abs(self.speed) < _SETTLED_TICKS_S:
            self.travel, self.speed = float(self._total), 0.0


class Encoders:
    """Encoders 0 and 1. ``enabled``: at least one has been set up; until then there is nothing to advance."""

    def __init__(self, period_s: float, simulated_speeds: tuple[float, float] = (0.0, 0.0)) -> None:
        self._encoders = (Encoder(period_s), Encoder(period_s))
        for encoder, speed in zip(self._encoders, simulated_speeds, strict=True):
            encoder.simulated_speed = speed
        self.enabled = False

    def __getitem__(self, index: int) -> Encoder:
        """Encoder by index. Raises IndexError for an unknown one."""
        if index not in (0, 1):
            raise IndexError(f"there is no encoder {index}: use 0 or 1")
        return self._encoders[index]

    @property
    def raw(self) -> tuple[int, int]:
        return self._encoders[0].raw, self._encoders[1].raw

    def decode(self, index: int, decoder: DecoderType, a: int, b: int) -> None:
        """Encoder.decode of one of them. Raises IndexError."""
        self[index].decode(decoder, a, b)
        self.enabled = True

    def expect_counts(self, index: int, range_id: int) -> None:
        """Encoder.expect_counts of one of them. Raises IndexError, ValueError."""
        self[index].expect_counts(range_id)
        self.enabled = True

    def advance(self, digital_inputs: int) -> None:
        for encoder in self._encoders:
            encoder.advance(digital_inputs)

    def publish(self, snapshot: Snapshot) -> None:
        snapshot.encoder0_raw, snapshot.encoder1_raw = self.raw
