"""Random programs that move the arm, random interventions meanwhile, and conditions that must hold in every period.

`programs()` draws a `Case`; `run(case)` steps it in virtual time and raises AssertionError with the period and the
running line if a condition does not hold.
"""

import logging
from dataclasses import dataclass, field
from math import cos, dist, isfinite, sin

from hypothesis import strategies as st

from emulator.commands.requests import DashboardLine, ScriptUnit
from emulator.controller import Controller
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from emulator.motion.servo import JointServo, ToolServo
from urproto.modes import ControlMode, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import RuntimeExceptionMessage
from urproto.robots import load_model
from urproto.robots.kinematics import Kinematics
from urproto.robots.model import DH
from urproto.versions import Series

ZERO = (0.0,) * 6
ROBOT_TIME_S = {Series.CB3: 6.0, Series.E: 2.5}  # a program is stopped after this time: similar numbers of periods
STAND_WITHIN_S = 1.0
COMPILED_WITHIN = 100  # periods
ROUNDING = 1e-5
MAX_ACCELERATION = 2.05  # times a joint's acceleration limit: `pacing` lets a path have twice that before it gives up
MAX_COMBINED = 12.0  # with force mode, conveyor, or offset, which have separate bounds; stops add to them
# the safety system's limits do not slow streams and additions to a path; it acts after 0.25 s beyond them
DETECTED_WITHIN_S = 0.3
HARD_SAFETY = (SafetyMode.VIOLATION, SafetyMode.FAULT)
STOPS_COUNTED = 50  # protective stops of one joint; another one is a fault
LEGAL_SAFETY = (SafetyMode.NORMAL, SafetyMode.REDUCED, SafetyMode.PROTECTIVE_STOP, SafetyMode.SAFEGUARD_STOP)


@dataclass(frozen=True)
class Case:
    """Consecutive programs, the initial position of the arm, and interventions at fractions of the time.

    ``patience_s``: time until an operator unlocks a protective stop and continues.
    """

    model: str
    start: tuple[float, ...]
    programs: tuple[tuple[str, ...], ...]
    touches: tuple[tuple[float, str, float], ...] = ()
    patience_s: float = 0.3

    @property
    def texts(self) -> list[str]:
        return ["def random():\n" + "".join(f"  {line}\n" for line in lines) + "end\n" for lines in self.programs]


# parts of programs


def _number(low: float, high: float) -> st.SearchStrategy[str]:
    return st.integers(0, 1000).map(lambda share: f"{low + (high - low) * share / 1000:.4f}")


def _joined(*parts: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.tuples(*parts).map("".join)


def _list(prefix: str, *numbers: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.tuples(*numbers).map(lambda texts: f"{prefix}[{', '.join(texts)}]")


_near = _number(-0.8, 0.8)


def _mostly(often: st.SearchStrategy[str], *seldom: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    """Usually the first: programs should make progress before something is out of reach."""
    return st.integers(0, 4).flatmap(lambda dice: st.one_of(*seldom) if dice == 0 else often)


_easy = _list("", _near, _number(-2.2, -0.9), _number(0.5, 2.2), _number(-2.2, -0.8), _number(-2.0, -1.0), _near)
_joints = _mostly(
    _easy,
    _list("", *[_number(-6.2, 6.2)] * 6),
    st.sampled_from(
        (
            "[0, -1.57, 0, -1.57, 0, 0]",  # stretched, the wrist singular too
            "[0, -1.2, 1.6, -1.9, 0, 0.4]",  # the wrist singular
            "[0.5, -0.3, 0.0001, -0.4, -1.5, 0]",  # the elbow nearly so
            "[0.2, -1.5, 2.9, -2.9, -1.5, 0]",  # folded
            "[9, 0, 0, 0, 0, 0]",  # beyond the limits
        )
    ),
)
_step, _turn = _number(-0.2, 0.2), _number(-1.0, 1.0)
_shift = _list("p", *[_step] * 3, *[st.just("0")] * 3)
_change = _list("p", *[_step] * 3, *[_turn] * 3)
_pose = _mostly(
    st.one_of(
        _shift.map(lambda change: f"pose_add(get_target_tcp_pose(), {change})"),
        _change.map(lambda change: f"pose_add(get_target_tcp_pose(), {change})"),
        _change.map(lambda change: f"pose_trans(get_target_tcp_pose(), {change})"),
    ),
    _easy.map(lambda q: f"get_forward_kin({q})"),
    _list("p", *[_number(-0.9, 0.9)] * 2, _number(-0.2, 0.9), *[_number(-3.1, 3.1)] * 3),
    st.just("p[3, 0, 0, 0, 0, 0]"),
    st.just("pose_trans(p[0, 0, 0, 0, 0, 2.5], get_target_tcp_pose())"),  # above or around the base axis
)
_a, _v = _number(0.1, 8.0), _number(0.05, 3.0)
_radius = st.one_of(st.just(""), _number(0.005, 0.3).map(lambda r: f", r={r}"))
_timing = st.one_of(
    _joined(st.just(", a="), _a, st.just(", v="), _v), _joined(st.just(", t="), _number(0.05, 2.0)), st.just("")
)
_pace = st.one_of(_joined(st.just(", a="), _a, st.just(", v="), _v), st.just(""))
_t = _number(0.002, 0.6)


def _call(name: str, *arguments: st.SearchStrategy[str]) -> st.SearchStrategy[list[str]]:
    return _joined(st.just(f"{name}("), *arguments, st.just(")")).map(lambda text: [text])


_moves = st.one_of(
    _call("movej", st.one_of(_joints, _pose), _timing, _radius),
    _call("movel", st.one_of(_pose, _joints), _timing, _radius),
    _call("movep", _pose, _pace, _radius),
    _call("movec", _pose, st.just(", "), _pose, _pace, _radius, st.sampled_from(("", ", mode=1"))),
)
_stops = st.one_of(
    _call("stopj", _number(0.2, 60.0)),
    _call("stopl", _number(0.2, 30.0), st.just(", "), _number(0.2, 60.0)),
    _call("sleep", _t),
)
_speeds = st.one_of(
    _call("speedj", _list("", *[_number(-4.0, 4.0)] * 6), st.just(", "), _a, st.just(", "), _t),
    _call("speedl", _list("", *[_number(-0.8, 0.8)] * 3, *[_turn] * 3), st.just(", "), _a, st.just(", "), _t),
)
_servoc = _call("servoc", _pose, _pace, _radius)


def _stream(target: str, count: int, lookahead: str, gain: str) -> list[str]:
    """Targets that move around a configuration, one per period."""
    return [
        f"q = {target}",
        "k = 0",
        f"while k < {count}:",
        "  q[0] = q[0] + 0.002",
        f"  servoj(q, t=get_steptime(), lookahead_time={lookahead}, gain={gain})",
        "  k = k + 1",
        "end",
    ]


_servoj = st.builds(_stream, _joints, st.integers(1, 300), _number(0.03, 0.2), st.integers(100, 2000).map(str))
_force = st.one_of(
    st.builds(
        lambda frame, axes, push, kind: [f"force_mode({frame}, {axes}, {push}, {kind}, [0.3, 0.3, 0.3, 1, 1, 1])"],
        st.one_of(_pose, st.just("p[0, 0, 0, 0, 0, 0]")),
        _list("", *[st.sampled_from("01")] * 6),
        _list("", *[_number(-40.0, 40.0)] * 3, *[_number(-3.0, 3.0)] * 3),
        st.integers(1, 3),
    ),
    st.just(["end_force_mode()"]),
    st.just(["freedrive_mode()"]),
    st.just(["end_freedrive_mode()"]),
)
_conveyor = st.one_of(
    st.just(["encoder_enable_pulse_decode(0, 1, 0, 1)", "track_conveyor_linear(p[0, 1, 0, 0, 0, 0], 1000)"]),
    st.just(["encoder_enable_pulse_decode(0, 1, 0, 1)", "track_conveyor_circular(p[0,0,0,0,0,0], 5000, True)"]),
    _call("stop_conveyor_tracking", _number(1.0, 30.0)),
)
_offset = st.one_of(
    st.just(["path_offset_enable()", "path_offset_set_alpha_filter(0.02)"]),
    _call("path_offset_set", _list("p", *[_number(-0.04, 0.04)] * 6), st.integers(1, 4).map(lambda k: f", {k}")),
    _call("path_offset_disable", _number(1.0, 30.0)),
)
_others = st.one_of(
    _call("set_tcp", _list("p", *[_step] * 3, *[_turn] * 3)),
    _call("set_payload", _number(0.0, 3.0)),
    _call("set_safety_mode_transition_hardness", st.sampled_from("01")),
    st.just(["protective_stop()"]),
)


def _thread(body: list[str], after: str) -> list[str]:
    """Moves in a thread that is killed midway."""
    inside = [f"  {line}" for line in body]
    return ["thread mover():", *inside, "end", "handle = run mover()", f"sleep({after})", "kill handle"]


_threads = st.builds(_thread, st.one_of(_moves, _speeds, _servoj), _t)


def _statements(series: Series) -> st.SearchStrategy[list[str]]:
    common = (_moves, _moves, _moves, _stops, _speeds, _servoj, _servoc, _force, _conveyor, _others, _threads)
    if series is Series.CB3:
        return st.one_of(*common)
    optimised = _joined(st.just(", a="), _number(0.05, 1.0), st.just(", v="), _number(0.05, 1.0), _radius)
    return st.one_of(*common, _offset, _call("optimovej", _joints, optimised), _call("optimovel", _pose, optimised))


_hands = st.tuples(
    st.floats(0.0, 1.0),
    st.sampled_from(("slider", "slider", "slider", "pause", "stop", "gate", "reduced", "push")),
    st.floats(0.0, 1.0),
)
_starts = st.sampled_from(
    (
        (0.0, -1.5, 1.5, -1.6, -1.57, 0.0),
        (0.4, -1.1, 1.9, -2.2, -1.2, 0.7),
        (0.0, -1.57, 0.0, -1.57, 0.0, 0.0),
        (-2.0, -2.0, -1.4, -0.9, 1.5, 3.0),
    )
)


def programs(model: str) -> st.SearchStrategy[Case]:
    """Programs for one arm."""
    statements = st.lists(_statements(load_model(model).series), min_size=1, max_size=5)
    program = statements.map(lambda parts: tuple(line for part in parts for line in part))
    return st.builds(
        Case,
        st.just(model),
        _starts,
        st.lists(program, min_size=1, max_size=4).map(tuple),
        st.lists(_hands, max_size=5).map(tuple),
        st.sampled_from((0.05, 0.3, 10.0)),
    )


# running them


@dataclass
class Outcome:
    """The result of a program."""

    periods: int = 0
    ended: bool = False
    faults: list[str] = field(default_factory=list)
    largest_acceleration: list[tuple[float, int, str]] = field(default_factory=list)  # rad/s2, period, activity


class Run:
    """One running program. Joint quantities in rad, rad/s, rad/s2."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.model = load_model(case.model)
        self.controller = Controller(ControllerConfig(model=self.model, initial_q=case.start, running=True))
        self.controller.encoders[0].simulated_speed = 80.0
        self.kinematics = Kinematics(self.model.dh)
        self.period = 0
        self.running = -1  # number of the program
        self.outcome = Outcome()
        self._q = self.controller.snapshot.target_q
        self._rates = ZERO
        self._stopped_for_s = 0.0
        self._was_deviating = False
        self._protective_stops = 0
        self._safety_mode = SafetyMode.NORMAL
        self._ungoverned_s = DETECTED_WITHIN_S  # start of the end of a motion that the safety system does not slow down

    def go(self) -> Outcome:
        controller, series = self.controller, self.model.series
        count = round(ROBOT_TIME_S[series] / series.period_s)
        touches = {round(share * count): (what, value) for share, what, value in self.case.touches}
        waiting = self.case.texts
        since = 0
        for period in range(count):
            if controller.safety.mode in HARD_SAFETY:
                break
            if period in touches:
                self._touch(*touches[period])
            if self._stopped_for_s > self.case.patience_s:
                self._recover()
            if period > since and controller.programs.state is RuntimeState.STOPPED:
                if not waiting:
                    self.outcome.ended = True
                    break
                controller.post(ScriptUnit(waiting.pop(0), "block"))
                self.running += 1
                since = period + COMPILED_WITHIN
            self.step()
        self._come_to_rest()
        self.outcome.periods = self.period
        return self.outcome

    def _touch(self, what: str, value: float) -> None:
        """An intervention on the robot."""
        controller = self.controller
        match what:
            case "slider":
                controller.speed.set_slider(value if value > 0.1 else 0.0)
            case "pause":
                controller.post(DashboardLine("pause" if value < 0.5 else "play"))
            case "stop":
                controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
            case "gate":
                controller.safety_event(SafetyEvent.SAFEGUARD_OPEN if value < 0.5 else SafetyEvent.SAFEGUARD_CLOSED)
            case "reduced":
                controller.safety_event(SafetyEvent.REDUCED if value < 0.5 else SafetyEvent.NOT_REDUCED)
            case "push":
                controller.external_wrench = (60.0 * value, -20.0, 30.0 * value - 15.0, 0.0, value, 0.0)

    def _recover(self) -> None:
        self.controller.safety_event(SafetyEvent.UNLOCK)
        self.controller.safety_event(SafetyEvent.SAFEGUARD_CLOSED)
        self.controller.programs.resume()

    def _come_to_rest(self) -> None:
        """After its end or a stop, the arm soon comes to rest and stays there."""
        controller = self.controller
        controller.external_wrench = ZERO
        controller.programs.stop("enough")
        for _ in range(round(STAND_WITHIN_S / controller.period_s)):
            if controller.motion.idle:
                break
            self.step()
        assert controller.motion.idle, self._at("the arm does not come to rest")
        stood = controller.snapshot.target_q
        for _ in range(3):
            self.step()
        assert controller.snapshot.target_q == stood, self._at("the arm does not stay")

    def step(self) -> None:
        """One control period, and all conditions that must hold after it."""
        self.controller.tick()
        self.period += 1
        self._check_motion()
        self._check_snapshot()
        self._check_modes()
        self._check_words()

    def _check_motion(self) -> None:
        snapshot, model, dt = self.controller.snapshot, self.model, self.controller.period_s
        q = snapshot.target_q
        assert all(map(isfinite, (*q, *snapshot.target_qd, *snapshot.target_qdd))), self._at("not finite")
        low, high = model.position_limits
        rates = tuple((now - before) / dt for now, before in zip(q, self._q, strict=True))
        for i in range(6):
            assert low[i] - ROUNDING <= q[i] <= high[i] + ROUNDING, self._at(f"joint {i} is at {q[i]}")
            assert abs(rates[i]) <= model.qd_max[i] * (1.0 + ROUNDING), self._at(f"joint {i} does {rates[i]} rad/s")
        if any(snapshot.target_qd):
            assert max(map(abs, map(float.__sub__, snapshot.target_qd, rates))) < 1e-6, self._at("speed is not dq/dt")
        largest_acceleration = max(
            abs(a - b) / (dt * m) for a, b, m in zip(rates, self._rates, model.qdd_max, strict=True)
        )
        if largest_acceleration > 1.0 + 1e-2:
            self.outcome.largest_acceleration.append((largest_acceleration, self.period, self._activity()))
        deviating = self.controller.motion.deviating or self._was_deviating
        assert largest_acceleration <= (MAX_COMBINED if deviating else MAX_ACCELERATION), self._at(
            f"a joint does {largest_acceleration:.2f} times qdd_max"
        )
        self._was_deviating = self.controller.motion.deviating
        self._q, self._rates = q, rates

    def _check_snapshot(self) -> None:
        snapshot = self.controller.snapshot
        assert snapshot.actual_q == snapshot.target_q, self._at("an ideal arm is where it is told to be")
        vectors = (snapshot.actual_TCP_pose, snapshot.actual_TCP_speed, snapshot.actual_TCP_force)
        torques = (snapshot.target_moment, snapshot.actual_current)
        assert all(map(isfinite, (v for vector in (*vectors, *torques) for v in vector))), self._at("not finite")
        here = self.kinematics.forward(snapshot.actual_q, snapshot.tcp_offset)
        assert dist(here[:3], snapshot.actual_TCP_pose[:3]) < 1e-9, self._at("the TCP is not where the joints put it")
        if self.period % 40 == 0:
            flange = flange_position(self.model.dh, snapshot.actual_q)
            assert dist(flange, self.kinematics.forward(snapshot.actual_q)[:3]) < 1e-6, self._at("kinematics")

    def _check_modes(self) -> None:
        snapshot = self.controller.snapshot
        if snapshot.safety_mode in HARD_SAFETY:
            self._check_hard_stop(snapshot.safety_mode)
            return
        if snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP is not self._safety_mode:
            self._protective_stops += 1
        self._safety_mode = snapshot.safety_mode
        streamed = isinstance(self.controller.motion.movement.generator, JointServo | ToolServo) or self._was_deviating
        self._ungoverned_s = 0.0 if streamed else self._ungoverned_s + self.controller.period_s
        assert snapshot.robot_mode is RobotMode.RUNNING, self._at(f"{snapshot.robot_mode!r}")
        assert snapshot.safety_mode in LEGAL_SAFETY, self._at(f"{snapshot.safety_mode!r}")
        assert snapshot.control_mode in (ControlMode.POSITION, ControlMode.FORCE, ControlMode.TEACH), self._at("mode")
        if not self.controller.safety.stopped:
            self._stopped_for_s = 0.0
            return
        assert not snapshot.program_running, self._at(f"a program runs in {snapshot.safety_mode!r}")
        self._stopped_for_s += self.controller.period_s
        standing = not any(snapshot.target_qd)
        assert standing or self._stopped_for_s < STAND_WITHIN_S, self._at("stopped, the arm still moves")

    def _check_hard_stop(self, mode: SafetyMode) -> None:
        """Only motion that the safety system does not slow down may be too fast for it; then brakes hold the arm."""
        if mode is SafetyMode.FAULT:
            assert self._protective_stops >= STOPS_COUNTED, self._at("a fault out of nothing")
        else:
            assert self._ungoverned_s < DETECTED_WITHIN_S, self._at("a path violates a limit of the safety system")
        self._stopped_for_s += self.controller.period_s
        standing = not any(self.controller.snapshot.target_qd)
        assert standing or self._stopped_for_s < STAND_WITHIN_S, self._at("the brakes do not hold the arm")

    def _check_words(self) -> None:
        for message in self.controller.snapshot.messages:
            if isinstance(message, RuntimeExceptionMessage):
                assert "internal error" not in message.text, self._at(message.text)
                self.outcome.faults.append(message.text)

    def _activity(self) -> str:
        motion = self.controller.motion
        line, lines = self.controller.programs.line, self.case.programs[max(self.running, 0)]
        added = "+compliance" * (motion.control_mode is not ControlMode.POSITION)
        text = lines[line - 2] if 2 <= line <= len(lines) + 1 else ""
        generator = type(motion.movement.generator).__name__
        return f"{generator}{added} {motion.fault and motion.fault.code} line {line} {text}"

    def _at(self, what: str) -> str:
        return f"{what}; {self.case.model}, period {self.period}, {self._activity()}\n{self.case}"


class _Errors(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(f"{record.getMessage()} {record.exc_info}")


def run(case: Case) -> Outcome:
    """Step a case to its end. AssertionError if a condition does not hold or an error was logged."""
    errors = _Errors()
    logging.getLogger("emulator").addHandler(errors)
    try:
        outcome = Run(case).go()
    finally:
        logging.getLogger("emulator").removeHandler(errors)
    assert not errors.texts, f"{errors.texts}\n{case}"
    return outcome


def flange_position(dh: DH, q: tuple[float, ...]) -> tuple[float, ...]:
    """The flange by its Denavit-Hartenberg chain, link by link, from the last one back."""
    point = (0.0, 0.0, 0.0)
    for i in reversed(range(6)):
        x, y, z = point
        s, c = sin(dh.alpha[i]), cos(dh.alpha[i])
        x, y, z = x + dh.a[i], c * y - s * z, s * y + c * z + dh.d[i]
        s, c = sin(q[i] + dh.theta[i]), cos(q[i] + dh.theta[i])
        point = (c * x - s * y, s * x + c * y, z)
    return point
