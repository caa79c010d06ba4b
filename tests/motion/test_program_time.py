"""A pause moves no target: pause, safeguard and protective stop only stretch the time of programs and movements."""

from random import Random

import pytest

from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from emulator.motion.program_time import RAMP_RAD_S2
from tests.rows import each_row
from urproto.modes import RuntimeState
from urproto.robots import load_model

START = (0.3, -1.6, 1.7, -1.5, -1.5, 0.2)
ROUNDING = 1e-9
# a control period at the highest speed of these programs, 0.5 rad/s: commands that are not given for a time, and a stop
# after them, take effect in the control period that is nearest, while the time of a program has not its full pace
A_PERIOD = 0.001

PUSH = "force_mode(p[0,0,0,0,0,0], [0,0,1,0,0,0], [0,0,-20,0,0,0], 2, [0.1,0.1,0.1,0.3,0.3,0.3])"
SPLINE = """
q = get_joint_positions()
qd = [0, 0, 0, 0, 0, 0]
t = 0
duration = 0.3005
while duration - t > get_steptime():
  t = t + get_steptime()
  wanted = [0.3, -0.1, 0.1, 0, 0, 0.1] * (6 * t / duration - 6 * t * t / duration / duration) / duration
  speedj(wanted, norm(wanted[0] - qd[0]) / get_steptime(), get_steptime())
  qd = wanted
end
speedj([0, 0, 0, 0, 0, 0], norm(qd[0]) / (duration - t), duration - t)
stopj(4)
"""
PROGRAMS = {
    "spline": (SPLINE, ROUNDING),
    "speedj": (
        """
i = 0
while i < 100:
  speedj([0.5, 0.1, 0, 0, 0, 0.2], 500, get_steptime())
  i = i + 1
end
stopj(5)
""",
        ROUNDING,
    ),
    "speedl": (
        """
i = 0
while i < 50:
  speedl([0.1, 0.05, 0, 0, 0, 0.2], 0.5, 2 * get_steptime())
  i = i + 1
end
stopl(1)
""",
        ROUNDING,
    ),
    "speedj and sleep": ("speedj([0.5, 0, 0, 0, 0, 0], 4)\nsleep(0.2)\nstopj(5)", ROUNDING),
    "servoj": (
        """
q = get_joint_positions()
i = 0
while i < 100:
  i = i + 1
  servoj(q + [0.001 * i, 0, 0, 0, 0, 0.0005 * i], t=get_steptime(), lookahead_time=0.03, gain=2000)
end
stopj(5)
""",
        A_PERIOD,
    ),
    "servoc": (
        """
p0 = get_target_tcp_pose()
servoc(pose_add(p0, p[0.04, 0, 0, 0, 0, 0]), 1.2, 0.25, 0.01)
servoc(pose_add(p0, p[0.04, 0.04, 0, 0, 0, 0]), 1.2, 0.25)
""",
        ROUNDING,
    ),
    "movej": (
        """
movej([0.5, -1.5, 1.6, -1.5, -1.5, 0.3], a=3, v=1, r=0.02)
movej([0.3, -1.4, 1.5, -1.5, -1.5, 0.3], a=3, v=1)
""",
        ROUNDING,
    ),
    "movel, then speedl": (
        """
p0 = get_target_tcp_pose()
movel(pose_add(p0, p[0.05, 0, 0, 0, 0, 0]), a=2, v=0.3, r=0.02)
movel(pose_add(p0, p[0.05, 0.05, 0, 0, 0, 0]), a=2, v=0.3)
speedl([0, 0.1, 0, 0, 0, 0], 1, 0.1)
stopl(2)
""",
        ROUNDING,
    ),
    "movep": (
        """
p0 = get_target_tcp_pose()
movep(pose_add(p0, p[0.04, 0, 0, 0, 0, 0]), a=2, v=0.2, r=0.02)
movep(pose_add(p0, p[0.04, 0.04, 0, 0, 0, 0]), a=2, v=0.2, r=0.02)
movep(pose_add(p0, p[0.0, 0.04, 0, 0, 0, 0]), a=2, v=0.2)
""",
        ROUNDING,
    ),
    "force mode": (f"{PUSH}\nsleep(0.25)\nend_force_mode()\nsleep(0.5)", A_PERIOD),
    "speedl in force mode": (
        f"""
{PUSH}
i = 0
while i < 100:
  speedl([0.1, 0.05, 0, 0, 0, 0], 5, get_steptime())
  i = i + 1
end
stopl(1)
end_force_mode()
sleep(0.5)
""",
        A_PERIOD,
    ),
    "path offset": (
        """
path_offset_enable()
i = 0
while i < 100:
  i = i + 1
  path_offset_set([0, 0, 0.0001 * i, 0, 0, 0], 1)
  speedl([0.1, 0.05, 0, 0, 0, 0], 5, get_steptime())
end
stopl(1)
path_offset_disable(2)
""",
        1e-5,
    ),
}
STOPS = {
    "pause": (lambda controller: controller.programs.pause(), lambda controller: None),
    "protective stop": (
        lambda controller: controller.safety_event(SafetyEvent.PROTECTIVE_STOP),
        lambda controller: controller.safety_event(SafetyEvent.UNLOCK),
    ),
    "safeguard stop": (
        lambda controller: controller.safety_event(SafetyEvent.SAFEGUARD_OPEN),
        lambda controller: controller.safety_event(SafetyEvent.SAFEGUARD_CLOSED),
    ),
}


class Arm:
    """A controller that runs one program in virtual time."""

    def __init__(self, body, model="ur5e"):
        self.controller = Controller(ControllerConfig(model=load_model(model), running=True, initial_q=START))
        self.qd, self.largest_qdd = self.controller.motion.qd, 0.0
        lines = "".join(f"  {line}\n" for line in body.strip().splitlines())
        self.controller.post(ScriptUnit(f"def moves():\n{lines}end\n", "moves"))
        while self.state is RuntimeState.STOPPED:
            self.tick()

    @property
    def state(self):
        return self.controller.programs.state

    def tick(self, count=1):
        for _ in range(count):
            self.controller.tick()
            qd, period_s = self.controller.motion.qd, self.controller.period_s
            changes = (abs(now - before) / period_s for now, before in zip(qd, self.qd, strict=True))
            self.qd, self.largest_qdd = qd, max(self.largest_qdd, *changes)

    def hold(self, stop="pause", wait_s=0.1, meanwhile=lambda: None):
        """Stop, wait at rest, continue."""
        controller, (begin, end) = self.controller, STOPS[stop]
        begin(controller)
        while self.state is RuntimeState.PAUSING:
            self.tick()
        stood = controller.motion.q, dict(controller.programs.variables)
        meanwhile()
        self.tick(round(wait_s / controller.period_s))
        if self.state is RuntimeState.PAUSED:
            assert (controller.motion.q, controller.programs.variables) == stood
        end(controller)
        controller.programs.resume()

    def finish(self):
        """Control periods until the program is over; it must not have failed."""
        for count in range(10_000):
            if self.state is RuntimeState.STOPPED and self.controller.motion.idle:
                assert self.controller.safety.programs_allowed
                assert not [line for line in self.controller.messages.history if "exception" in line.lower()]
                return count
            self.tick()
        raise AssertionError(f"the program is still {self.state.name}")


def away(q, expected):
    return max(abs(a - b) for a, b in zip(q, expected, strict=True))


def undisturbed(body, model="ur5e"):
    arm = Arm(body, model)
    periods = arm.finish()
    return arm, periods


def sweep(name, stop, every):
    """Stop once in every n-th period of a program; its end must be that of the undisturbed run."""
    body, tolerance = PROGRAMS[name]
    free, periods = undisturbed(body)
    ramp = RAMP_RAD_S2 if stop == "pause" else 40.0
    for at in range(1, periods, every):
        arm = Arm(body)
        arm.tick(at)
        arm.hold(stop)
        arm.finish()
        off = away(arm.controller.motion.q, free.controller.motion.q)
        assert off <= tolerance, f"{stop} after {at} periods: {off} rad off"
        assert arm.largest_qdd <= 1.02 * (free.largest_qdd + ramp)  # differences of speeds in whole periods


@each_row("name", PROGRAMS)
def test_a_pause_moves_no_target(name):
    sweep(name, "pause", 71)


@each_row("name", ["spline", "speedj", "servoj", "movel, then speedl", "force mode"])
@each_row("stop", ["protective stop", "safeguard stop"])
def test_a_stop_by_the_safety_system_moves_no_target(name, stop):
    sweep(name, stop, 97)


def test_a_pause_near_the_end_of_a_spline_moves_no_target():
    """The last commands are given while the time slows down."""
    body, tolerance = PROGRAMS["spline"]
    free, _ = undisturbed(body)
    for at in range(131, 156, 3):
        arm = Arm(body)
        arm.tick(at)
        arm.hold(wait_s=0.02)
        arm.finish()
        assert away(arm.controller.motion.q, free.controller.motion.q) <= tolerance, f"after {at} periods"


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("stop", STOPS)
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_stop_in_any_period_moves_no_target(name, stop):
    every = 1 if name in ("spline", "speedj") else 5
    sweep(name, stop, every if stop == "pause" else 7 * every)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(1, 4))])
@pytest.mark.parametrize("name", ["spline", "speedj", "speedl", "movej", "movep", "servoc"])
def test_two_pauses_and_a_moved_slider_move_no_target(name, seed):
    """The slider is moved while the arm runs, brakes, stands and gains speed; before the end, it is where it was.

    A stop takes place at the speed that the arm then has.
    """
    body, tolerance = PROGRAMS[name]
    free, periods = undisturbed(body)
    random, arm = Random(f"{name} {seed}"), Arm(body)
    slider = arm.controller.speed.set_slider
    for _ in range(2):
        arm.tick(random.randrange(1, periods // 10))
        slider(random.choice((0.0, 0.3, 1.0)))
        arm.tick(random.randrange(10))
        arm.hold(meanwhile=lambda: slider(random.choice((0.0, 0.5, 1.0))))
        arm.tick(random.randrange(1, 10))
        slider(1.0)
    arm.finish()
    assert away(arm.controller.motion.q, free.controller.motion.q) <= max(tolerance, 1e-7)


@pytest.mark.parametrize("model", ["ur3", pytest.param("ur5e", marks=pytest.mark.long)])
def test_a_stream_of_speeds_covers_speed_times_time(model):
    """Reported: 1000 commands of one period each, a pause after a second, 1.050 rad instead of 1.000."""
    body = """
    i = 0
    while i < 1000:
      speedj([0.5, 0, 0, 0, 0, 0], 500, get_steptime())
      i = i + 1
    end
    stopj(10)
    """
    free, _ = undisturbed(body, model)
    arm = Arm(body, model)
    arm.tick(round(1.0 / arm.controller.period_s))
    arm.hold(wait_s=0.6)
    arm.finish()
    assert away(arm.controller.motion.q, free.controller.motion.q) <= ROUNDING


def test_pausing_again_and_again_moves_no_target():
    """Also a pause while the arm still gains speed, and a resume while it still brakes."""
    body, tolerance = PROGRAMS["spline"]
    free, _ = undisturbed(body)
    random, arm = Random(5), Arm(body)
    for _ in range(40):
        arm.tick(random.randrange(20))
        arm.controller.programs.pause()
        arm.tick(random.randrange(30))
        arm.controller.programs.resume()
    arm.finish()
    assert away(arm.controller.motion.q, free.controller.motion.q) <= tolerance


def test_a_blocking_popup_of_another_thread_moves_no_target():
    stream = PROGRAMS["speedj"][0]
    body = f"thread asks():\n  sleep(0.1)\n{{}}  asked = True\nend\nasked = False\nh = run asks()\n{stream}\njoin h\n"
    free, _ = undisturbed(body.format(""))
    arm = Arm(body.format('  popup("continue?", blocking=True)\n'))
    while not arm.controller.popups.shown:
        arm.tick()
    arm.tick(200)
    assert arm.controller.motion.qd == (0.0,) * 6
    assert arm.controller.programs.variables["asked"] is False
    arm.controller.popups.close_all()
    arm.finish()
    assert away(arm.controller.motion.q, free.controller.motion.q) <= ROUNDING


def test_threads_keep_step_with_the_arm():
    """A thread that counts its frames counts as many during a movement, however often that is paused."""
    body = """
    counted = 0
    thread counts():
      while True:
        counted = counted + 1
        sync()
      end
    end
    h = run counts()
    movej([0.8, -1.6, 1.7, -1.5, -1.5, 0.2], a=3, v=1)
    moved = counted
    kill h
    sync()
    sync()
    """

    def frames(pauses):
        arm, counted = Arm(body), 0
        for at in pauses:
            arm.tick(at)
            arm.hold()
        while arm.state is not RuntimeState.STOPPED:
            counted = arm.controller.programs.variables.get("moved", counted)
            arm.tick()
        return counted

    free = frames(())
    assert free > 300
    assert [frames(pauses) for pauses in ((10,), (60, 40), (10, 10, 10), (333,))] == [free] * 4
