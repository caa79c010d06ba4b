"""No text, program or stream takes more than its share of a control period. Many more in `make soak`."""

import os
from collections.abc import Callable
from random import Random

import pytest
from costs import (
    SOURCES,
    busy_program,
    long_source,
    longest_tick,
    min_time,
    objects_left_by,
    slowness,
    source,
    steps_of,
    tick_times,
)

from emulator.programs.compiling import LIBRARY_SET
from emulator.servers.read_budget import SHARE, ReadBudget
from tests.budget import subset
from urproto.dashboard import LineDecoder
from urproto.interpreter import StatementDecoder
from urproto.modbus import FrameDecoder
from urproto.robotiq import RequestDecoder
from urproto.rtde.codec import RTDEDecoder
from urproto.versions import DEFAULT_VERSION, Series
from urscript import compiler
from urscript.splitter import ScriptSplitter

RANDOM_COSTS_COUNT = os.environ.get("RANDOM_COSTS")
EACH = int(RANDOM_COSTS_COUNT or 12) // 2
HALF_S = {"ur3": Series.CB3.period_s / 2, "ur5e": Series.E.period_s / 2}
MAX_STEP = 2600  # units of `urscript.work`: half a period of a CB3 arm. One statement may take as many
MAX_START = 10_500  # of these, to start a program of as many defs and threads as there may be; others: as above
# Processor time on a shared core is up to three times as long alongside other tests. What is exact there
# is the count of `test_every_step_of_compiling_a_long_text_is_short`; `make soak` measures times.
CROWDED = 1.25 if RANDOM_COSTS_COUNT else 4.0
COMPILED_WITHIN = 10  # periods
# In every run; the work on all of them is counted.
TIMED = (
    "a list of lists",
    "a long def",
    "a long call",
    "threads",
    "no end",
)
SIZE = 2000 if RANDOM_COSTS_COUNT is None else 20_000

CHUNK = 1024  # as a port reads
STREAMS: dict[str, tuple[Callable[[], object], Callable[[int], bytes]]] = {
    "blanks": (ScriptSplitter, lambda n: b" " * n),
    "lines": (ScriptSplitter, lambda n: b"\n" * n),
    "a comment": (ScriptSplitter, lambda n: b"#" + b"x" * n),
    "comments": (ScriptSplitter, lambda n: b"# x\n" * (n // 4)),
    "byte order marks": (ScriptSplitter, lambda n: b"\xef\xbb\xbf" * (n // 3)),
    "a word": (ScriptSplitter, lambda n: b"x" * n),
    "a word in a block": (ScriptSplitter, lambda n: b"def f():\n" + b"x" * n),
    "words in a block": (ScriptSplitter, lambda n: b"def f():\n" + b"a " * (n // 2)),
    "a string in a block": (ScriptSplitter, lambda n: b'def f():\n"' + b"x" * n),
    "a comment in a block": (ScriptSplitter, lambda n: b"def f():\n#" + b"x" * n),
    "quotes in a block": (ScriptSplitter, lambda n: b"def f():\n" + b'"' * n),
    "nested blocks": (ScriptSplitter, lambda n: b"if " * (n // 3)),
    "dashboard lines": (LineDecoder, lambda n: b"robotmode\n" * (n // 10)),
    "interpreter, a line": (StatementDecoder, lambda n: b"x" * n),
    "interpreter, lines": (StatementDecoder, lambda n: b"x\n" * (n // 2)),
    "gripper": (RequestDecoder, lambda n: b"GET POS\n" * (n // 8)),
    "Modbus": (FrameDecoder, lambda n: b"\0\1\0\0\0\6\0\3\0\x80\0\1" * (n // 12)),
    "RTDE, long packages": (RTDEDecoder, lambda n: (b"\xff\xffU" + bytes(0xFFFC)) * (n // 0xFFFF)),
    "RTDE, short packages": (RTDEDecoder, lambda n: b"\0\3U" * (n // 3)),
}


def feed(make: Callable[[], object], data: bytes) -> None:
    decoder = make()
    for start in range(0, len(data), CHUNK):
        decoder.feed(data[start : start + CHUNK])  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", subset(STREAMS, now=("words in a block", "dashboard lines")))
def test_the_cost_of_a_byte_does_not_depend_on_earlier_bytes(name: str) -> None:
    """Four times the bytes take four times as long; code that restarts at each chunk would take sixteen times as
    long."""
    make, data = STREAMS[name]
    few, many = data(250_000), data(1_000_000)
    for _ in range(3):
        ratio = min_time(lambda: feed(make, many)) / min_time(lambda: feed(make, few))
        if ratio < 9:
            break
    assert ratio < 9


@pytest.mark.parametrize("data", [b" " * 400_000, b"#" + b"x" * 400_000], ids=["blanks", "a comment"])
def test_reading_byte_by_byte_gives_the_same_result(data: bytes) -> None:
    def one_by_one(count: int) -> None:
        splitter = ScriptSplitter()
        for byte in data[:count]:
            splitter.feed(bytes([byte]))

    assert min_time(lambda: one_by_one(40_000)) < 9 * min_time(lambda: one_by_one(10_000))


@pytest.mark.long
@pytest.mark.timeout(0 if RANDOM_COSTS_COUNT else 120)
@pytest.mark.parametrize("model", HALF_S)
def test_a_busy_program_uses_at_most_half_the_period(model: str) -> None:
    bound_s = CROWDED * HALF_S[model] * slowness()
    for seed in range(EACH):
        text = busy_program(Random(seed))
        longest, period = longest_tick(text, 80, model, bound_s, after=COMPILED_WITHIN)
        assert longest <= bound_s, f"seed {seed}, period {period}: {longest * 1e3:.2f} ms\n{text[-400:]}"


@pytest.mark.parametrize("name", SOURCES)
def test_every_step_of_compiling_a_long_text_is_short(name: str) -> None:
    """By count: a step is work that cannot be interrupted. The next test shows that the count is right."""
    *steps, last = [0, *steps_of(source(name, SIZE))]
    assert max(steps, default=0) <= MAX_STEP
    assert last <= (MAX_START if RANDOM_COSTS_COUNT else MAX_STEP)


@pytest.mark.long
@pytest.mark.parametrize(
    "name", SOURCES if RANDOM_COSTS_COUNT else ["functions that call each other", "a long call", "threads"]
)
def test_a_long_text_leaves_little_to_the_garbage_collector(name: str) -> None:
    """It is paused while a text is compiled; then it examines all remaining objects in one step."""
    text = source(name, SIZE)
    left, garbage = objects_left_by(text)
    assert left <= 400 + text.count("\n")
    assert not garbage


def test_replaced_programs_are_freed_in_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    long = source("a long def", SIZE)
    monkeypatch.setattr(compiler, "_cache", compiler.CompiledPrograms())
    monkeypatch.setattr(compiler, "_CACHE_CHARACTERS", len(long))
    compiler.compile_script(long, LIBRARY_SET, DEFAULT_VERSION[Series.E])
    compiler._discarded.clear()
    compiler.compile_script("def short():\n  a = 1\nend\n", LIBRARY_SET, DEFAULT_VERSION[Series.E])
    left = len(compiler._discarded)
    assert left > SIZE // 400  # pieces of the long one
    for _ in compiler.compile_steps("def next():\n  a = 2\nend\n", LIBRARY_SET, DEFAULT_VERSION[Series.E]):
        assert len(compiler._discarded) == max(0, left - compiler._SLICE)
        left = len(compiler._discarded)


@pytest.mark.long
@pytest.mark.timeout(0 if RANDOM_COSTS_COUNT else 120)
@pytest.mark.parametrize("name", subset(SOURCES, now=TIMED))
def test_compiling_a_long_text_uses_at_most_half_the_period(name: str) -> None:
    bound_s = CROWDED * HALF_S["ur3"] * slowness()
    if RANDOM_COSTS_COUNT and name == "threads":
        bound_s *= 5  # Python defines 5,000 of them in one step, when the program starts: see MAX_START
    longest, period = longest_tick(source(name, SIZE), 300, "ur3", bound_s)
    assert longest <= bound_s, f"period {period}: {longest * 1e3:.2f} ms"


@pytest.mark.timeout(0 if RANDOM_COSTS_COUNT else 120)
@pytest.mark.skipif(not RANDOM_COSTS_COUNT, reason="every kind of text is covered; mixtures are for the soak test")
def test_random_long_texts() -> None:
    bound_s = CROWDED * HALF_S["ur3"] * slowness()
    for seed in range(EACH // 10):
        longest, period = longest_tick(long_source(Random(seed), SIZE), 600, "ur3", bound_s)
        assert longest <= bound_s, f"seed {seed}, period {period}: {longest * 1e3:.2f} ms"


def test_compiling_keeps_to_its_share_on_average_regardless_of_piece_size() -> None:
    """A function that Python compiles in one step is compensated for in the following periods."""
    body = "".join(f"    if n == {i}:\n      return {i}\n    end\n" for i in range(600))
    text = f"def p():\n  def f(n):\n{body}    return 0\n  end\n  while True:\n    sync()\n  end\nend\n"
    for _ in range(3):
        times = tick_times(text, 200, "ur5e")
        if sum(times) <= len(times) * CROWDED * HALF_S["ur5e"] * slowness():
            break
    assert sum(times) <= len(times) * CROWDED * HALF_S["ur5e"] * slowness()


class _Reader:
    def __init__(self) -> None:
        self.stalled = False

    def stall(self, reason: object) -> None:
        self.stalled = True

    def unstall(self, reason: object) -> None:
        self.stalled = False


@pytest.mark.parametrize("clients", [1, 2, 3])
async def test_reading_all_clients_keeps_to_its_share_of_time(clients: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """In virtual time: clients that always send, and the cost of reading them."""
    now_s, wakes = 0.0, []

    class Loop:
        def call_later(self, delay_s: float, call: Callable[[], None]) -> None:
            wakes.append((now_s + delay_s, call))

    monkeypatch.setattr("emulator.servers.read_budget.time.monotonic", lambda: now_s)
    monkeypatch.setattr("emulator.servers.read_budget.asyncio.get_running_loop", Loop)
    budget, readers, used_s = ReadBudget(0.002), [_Reader() for _ in range(clients)], 0.0
    for _ in range(20_000):
        for reader in readers:
            if not reader.stalled:
                budget.spent(reader, 0.0003)
                used_s += 0.0003
                now_s += 0.0003
        now_s += 0.0001
        while wakes and wakes[0][0] <= now_s:
            wakes.pop(0)[1]()
    assert 0.8 * SHARE < used_s / now_s < 1.05 * SHARE
    assert not all(reader.stalled for reader in readers) or wakes  # no client waits for ever
