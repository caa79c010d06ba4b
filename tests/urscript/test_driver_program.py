"""A program built like a driver's: commands from a socket, one motion thread per mode, a buffer drained on cancel.

It uses what such programs use: nested defs with defaults and keywords, forward references, handles
that are 0 before a thread runs, critical sections around blocking reads and motion, kill and join,
list arithmetic, names like built-ins, a condition over several lines.
"""

from collections import deque
from collections.abc import Generator
from dataclasses import dataclass, field

import pytest

from urproto.versions import PolyscopeVersion
from urscript import Library, LibrarySet, Runtime, ScriptThread, compile_script
from urscript.library import LIBRARIES
from urscript.values import Any_, Int, ListArg, Num, to_text

PROGRAM = """
def driver():
	# constants
	SCALE = 1000000
	IDLE = 0
	SERVO = 1
	PATH = 2
	STOP = -2

  global mode = -1
  global target = [0, 0, 0]
  global points_left = 0
  motion = 0
  cleaner = 0

  def describe(time, list, name="point", digits=3):
    local max = highest(list)
    return str_cat(str_cat(name, " "), str_cat(list, str_cat(" max ", str_cat(max, str_cat(" t=", time)))))
  end

  def highest(list):
    local length = get_list_length(list)
    local best = norm(list[0])
    local index = 1
    while index < length:
      local here = norm(list[index])
      if here > best:
        best = here
      end
      index = index + 1
    end
    return best
  end

  thread servo_thread():
    while mode == SERVO:
      enter_critical
      q = target
      servo(q, t=get_period())
      exit_critical
    end
    halt_motion(4.0)
  end

  thread path_thread():
    enter_critical
    while points_left > 0:
      local raw = read_ints(4, "path", 0.5)
      points_left = points_left - 1
      if raw[0] > 0:
        local point = [raw[1], raw[2], raw[3]] / SCALE
        local step = (-3 * point + point * 3 + point) / pow(1, 2)
        move(step)
        textmsg(describe(0.5, digits=1, list=step))
      else:
        textmsg("no more points")
        points_left = 0
      end
    end
    exit_critical
    send_int(0, "path")
  end

  thread drain():
    local reads = 0
    while points_left > 0:
      raw = read_ints(4, "path", 0)
      points_left = points_left - 1
      reads = reads + 1
      if reads >= 2:
        sync()
        reads = 0
      end
    end
  end

  timeout = 0
  while mode > STOP:
    enter_critical
    command = read_ints(5, "reverse", timeout)
    if command[0] > 0:
      timeout = command[1] / 1000.0
      if mode != command[5]:
        if mode == PATH:
          kill motion
          cleaner = run drain()
          halt_motion(4.0)
          join cleaner
          cleaner = 0
        end
        mode = command[5]
        join motion
        if mode == SERVO:
          motion = run servo_thread()
        elif mode == PATH or
          mode == PATH + 100 or
          mode == PATH + 200:
          points_left = command[2]
          motion = run path_thread()
        end
      end
      if mode == SERVO:
        target = [command[2] / SCALE, command[3] / SCALE, command[4] / SCALE]
      end
    else:
      textmsg("timed out")
      mode = STOP
      kill motion
      kill cleaner
      halt_motion(4.0)
      halt
    end
    exit_critical
  end
  join motion
  textmsg("stopped")
end
"""

ROBOT = Library("robot", host=True)


@dataclass
class Robot:
    """Sockets as queues of integers, motion as a log."""

    period_s: float = 0.002
    inbox: dict[str, deque[int]] = field(default_factory=lambda: {"reverse": deque(), "path": deque()})
    sent: list[tuple[str, int]] = field(default_factory=list)
    log: list[str] = field(default_factory=list)

    def on_label(self, number: int, text: str, option: str, thread: ScriptThread) -> bool:
        raise AssertionError("the program has no labels")


@ROBOT.builtin()
def get_period(host: Robot) -> float:
    """Control period [s]."""
    return host.period_s


@ROBOT.builtin()
def read_ints(host: Robot, number: Int, socket: Any_, timeout: Num) -> Generator[None, None, list[int]]:
    """Count and integers; waits for ever when the timeout is not positive."""
    inbox, frames = host.inbox[socket], 0
    while len(inbox) < number:
        if 0 < timeout <= frames * host.period_s:
            return [0] + [-1] * number
        frames += 1
        yield
    return [number] + [inbox.popleft() for _ in range(number)]


@ROBOT.builtin()
def send_int(host: Robot, value: Int, socket: Any_) -> None:
    """Record an answer."""
    host.sent.append((socket, value))


@ROBOT.builtin()
def servo(host: Robot, q: ListArg, t: Num = 0.008) -> Generator[None, None, None]:
    """One step towards a target."""
    host.log.append(f"servo {q}")
    yield


@ROBOT.builtin()
def move(host: Robot, q: ListArg) -> Generator[None, None, None]:
    """A move of five frames."""
    host.log.append(f"move {q}")
    for _ in range(5):
        yield


@ROBOT.builtin()
def halt_motion(host: Robot, a: Num) -> Generator[None, None, None]:
    """Stop within a frame."""
    host.log.append("halt_motion")
    yield


@ROBOT.builtin()
def textmsg(host: Robot, s1: Any_) -> None:
    """Record a message."""
    host.log.append(to_text(s1, message=True))


SET = LibrarySet([*LIBRARIES, ROBOT])


@pytest.fixture(params=["5.22", "5.9.4", "3.15.8"])
def driver(request):
    """A running driver program and its robot."""
    program = compile_script(PROGRAM, SET, PolyscopeVersion.parse(request.param))
    assert not program.warnings
    robot = Robot()
    return Runtime(program, robot), robot


def steps(runtime: Runtime, count: int) -> None:
    for _ in range(count):
        runtime.step()
        assert runtime.error is None


def test_waits_for_ever_for_its_first_command(driver):
    runtime, robot = driver
    steps(runtime, 2000)
    assert not runtime.finished
    assert robot.log == []


def test_servo_takes_one_command_each_frame(driver):
    runtime, robot = driver
    for number in range(1, 6):
        robot.inbox["reverse"] += [20, number * 1000000, 0, 500000, 1]
        steps(runtime, 1)
    # the thread runs in the frame the body starts it in, and from then on before the body
    assert robot.log == [f"servo {[float(n), 0.0, 0.5]}" for n in (1, 1, 2, 3, 4)]


def test_silence_ends_the_program_after_the_timeout(driver):
    runtime, robot = driver
    robot.inbox["reverse"] += [20, 0, 0, 0, 1]
    steps(runtime, 30)
    assert runtime.finished
    assert runtime.halted
    assert robot.log[-2:] == ["timed out", "halt_motion"]
    assert 10 <= robot.log.count("servo [0.0, 0.0, 0.0]") <= 12


def test_a_path_runs_beside_the_blocked_main_loop(driver):
    runtime, robot = driver
    robot.inbox["path"] += [1000000, 0, 0, 9, 0, 2000000, 0, 9]
    robot.inbox["reverse"] += [0, 2, 0, 0, 2]
    steps(runtime, 15)
    assert robot.sent == [("path", 0)]
    assert robot.log == [
        "move [1.0, 0.0, 0.0]",
        "point [1, 0, 0] max 1 t=0.5",
        "move [0.0, 2.0, 0.0]",
        "point [0, 2, 0] max 2 t=0.5",
    ]


def test_cancel_kills_the_path_and_drains_its_points(driver):
    runtime, robot = driver
    robot.inbox["path"] += [1000000, 0, 0, 9] * 7
    robot.inbox["reverse"] += [0, 7, 0, 0, 2]
    steps(runtime, 3)
    robot.inbox["reverse"] += [0, 0, 0, 0, 0]
    steps(runtime, 8)
    assert robot.log == ["move [1.0, 0.0, 0.0]", "halt_motion"]
    assert not robot.inbox["path"]
    assert runtime.globals["points_left"] == 0
    robot.inbox["reverse"] += [0, 0, 0, 0, -2]
    steps(runtime, 3)
    assert runtime.finished
    assert robot.log[-1] == "stopped"
