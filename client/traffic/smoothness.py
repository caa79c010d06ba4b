"""Why a streamed motion is not smooth: the program's setpoints, their timing, the robot's servoing, or the arm.

The same motion is compared in four forms: the setpoints as the program computed them (evenly spaced, whenever they
were sent), the setpoints as they were sent, the positions that the robot aimed at, and those that the arm reached. Each
has a roughness: its distance from the parabolas that fit it best within 60 ms. The first form that is much rougher than
the one before it tells where the roughness comes from.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from client.errors import RecordingError
from client.traffic.recording import TrafficRecording
from client.traffic.setpoints import (
    Array,
    ScriptLines,
    SentStates,
    SetpointStream,
    interpolated,
    script_lines,
    streams_and_states,
)
from urproto.joints import JOINT_LABELS
from urproto.modes import RuntimeState, SafetyMode, mode_name

_PAUSE_S: Final = 1.0  # guess: a longer interval is a pause of the program's
_GRID_S: Final = 0.002
_WINDOW: Final = 30  # grid steps to each side of a fitted parabola
_ROUGH_MRAD: Final = 1.0  # guess: more is felt at the arm
_ROUGHER: Final = 1.5  # guess: a form this much rougher than the one before adds something of its own
_GAP_PERIODS: Final = 2.5  # guess: a longer interval is more than jitter
_LATE_S: Final = 0.004  # guess: an interval longer by less is jitter
_TOGETHER: Final = 0.5  # guess, of the usual interval: setpoints closer to each other came together
_REPEATED: Final = 0.4  # guess: share of equal setpoints from which on they are a staircase
_SLOW_HZ: Final = 60.0  # guess: fewer setpoints than this are felt as steps, even through servoj's filter
_FAR_RAD: Final = 0.05  # guess: from here on, a first setpoint makes the arm jump
_FASTEST_RAD_S: Final = 2 * np.pi  # of the fastest joints: the wrists of a UR3 (urproto.robots)
_EXPECTED: Final = 1.5  # guess: times servoj's lag, before it is called large
_SLACK_S: Final = 0.03  # guess
_PASSED: Final = 0.1  # guess, of a roughness: more than this is worth a change of servoj's parameters
_LONGEST_LAG_S: Final = 0.5  # guess: servoj's is at most 0.13 s, by docs/reference/motion.md
_BACKLOG_S: Final = 0.05  # guess: more is no error of measurement
_LINES_HZ: Final = 2.0  # guess: more scripts per second than this are a stream
_LISTED: Final = 5


class Cause(str, Enum):
    """Where a finding comes from."""

    PROGRAM = "program"
    NETWORK = "network"
    CONTROLLER = "controller"
    ARM = "arm"


@dataclass(frozen=True, slots=True)
class StreamFinding:
    """Something that makes a motion rough. text: what was measured. advice: what to change."""

    cause: Cause
    text: str
    advice: str


@dataclass(frozen=True, slots=True)
class MotionForm:
    """One form of a motion; each number is that of the joint with the largest one.

    speed_rad_s: largest speed. rms_mrad, largest_mrad: roughness. joint: the roughest one, its label.
    """

    name: str
    speed_rad_s: float
    rms_mrad: float
    largest_mrad: float
    joint: str


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """When setpoints were sent. duration_s: without pauses. interval_ms: median, 99th percentile and longest.

    distinct_hz: setpoints per second that differ from the one before them.
    """

    count: int
    duration_s: float
    rate_hz: float
    distinct_hz: float
    interval_ms: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class StreamReport:
    """What was measured of a stream. lag_s: of the robot's target behind the setpoints; None if unknown."""

    source: str
    timing: StreamTiming
    lag_s: float | None
    forms: tuple[MotionForm, ...]
    findings: tuple[StreamFinding, ...]


@dataclass(frozen=True, slots=True)
class Smoothness:
    """What was found in a recording. scripts: about motion commands that were sent as scripts. remarks: what the
    recording does not show."""

    streams: tuple[StreamReport, ...]
    scripts: tuple[StreamFinding, ...]
    remarks: tuple[str, ...]

    @property
    def findings(self) -> list[StreamFinding]:
        """All findings."""
        return [*(finding for stream in self.streams for finding in stream.findings), *self.scripts]


def examine(recording: TrafficRecording) -> Smoothness:
    """Examine every stream of setpoints. Raises RecordingError if there is none, and no stream of scripts either."""
    streams, states = streams_and_states(recording)
    reports = tuple(_report(stream, states) for stream in streams)
    scripts = tuple(_about_scripts(script_lines(recording)))
    if not reports and not scripts:
        raise RecordingError(
            f"{recording.path} contains no stream of setpoints: they are expected in RTDE input registers (as ur_rtde "
            "sends them), on External Control's port 50001 (ur-client proxy --driver), or as scripts"
        )
    remarks = []
    if states is None:
        remarks.append(
            "no RTDE states with actual_q were recorded, so only the setpoints are examined: let ur-client watch "
            "actual_q target_q run through the proxy, too"
        )
    return Smoothness(reports, scripts, (*recording.problems, *remarks))


def _report(stream: SetpointStream, states: SentStates | None) -> StreamReport:
    timing = _timing(stream)
    during = None if states is None else _during(states, stream.time_s[0], stream.time_s[-1])
    forms, lag_s, backlog_s = list[MotionForm](), None, 0.0
    if stream.joints:
        forms = list(_forms(stream, timing, during))
        if during is not None and "target_q" in during.values:
            lag_s, backlog_s = _lag(stream, during)
    findings = [
        *(_about_start(stream, during) if stream.joints and during is not None else ()),
        *(_about_setpoints(stream, timing) if stream.joints else ()),
        *_about_timing(stream, timing, during),
        *_about_servoing(stream, lag_s, backlog_s),
        *_about_forms(forms, _unavoidable(stream, timing)),
        *_about_filtering(stream, forms),
        *(_about_states(during) if during is not None else ()),
    ]
    return StreamReport(stream.source, timing, lag_s, tuple(forms), tuple(findings))


# timing


def _timing(stream: SetpointStream) -> StreamTiming:
    intervals = np.diff(stream.time_s)
    intervals = intervals[intervals < _PAUSE_S]
    duration = max(float(intervals.sum()), 1e-9)
    distinct = int(np.count_nonzero(_changed(stream)))
    shown = [1e3 * float(np.percentile(intervals, share)) if len(intervals) else 0.0 for share in (50, 99, 100)]
    return StreamTiming(
        len(stream.time_s), duration, len(intervals) / duration, distinct / duration, (shown[0], shown[1], shown[2])
    )


def _changed(stream: SetpointStream) -> NDArray[np.bool_]:
    """Whether each setpoint after the first differs from the one before it."""
    changed: NDArray[np.bool_] = np.any(np.diff(stream.values, axis=0) != 0.0, axis=1)
    return changed


def _about_timing(stream: SetpointStream, timing: StreamTiming, states: SentStates | None) -> Iterator[StreamFinding]:
    usual = timing.interval_ms[0] / 1e3
    intervals = np.diff(stream.time_s)
    long = (intervals > max(_GAP_PERIODS * usual, usual + _LATE_S)) & (intervals < _PAUSE_S)
    gaps: list[int] = np.flatnonzero(long).tolist()
    late = [gap for gap in gaps if _came_together(intervals, gap, usual)]
    both = [gap for gap in late if states is not None and _states_late(states, stream.time_s[gap : gap + 2])]
    on_time = [gap for gap in late if gap not in both]
    never = [gap for gap in gaps if gap not in late]
    if never:
        yield StreamFinding(
            Cause.PROGRAM,
            f"{_times(never)} no setpoint was sent for a while: {_moments(stream, intervals, never)}",
            "compute setpoints in advance, or in a thread of their own, so that one can be sent in every period",
        )
    if on_time:
        yield StreamFinding(
            Cause.PROGRAM,
            f"{_times(on_time)} setpoints were held back, then sent together: {_moments(stream, intervals, on_time)}"
            + ("" if states is None else "; the robot's states were on time meanwhile"),
            "the sender was not scheduled, or it catches up after a delay: give it real-time priority, send only the "
            "latest setpoint after a delay, and set TCP_NODELAY",
        )
    if both:
        yield StreamFinding(
            Cause.NETWORK,
            f"{_times(both)} setpoints and states came late, then together: {_moments(stream, intervals, both)}",
            "use a cable, no wireless link and no busy switch; or the machine that recorded was busy",
        )


def _times(gaps: Sequence[int]) -> str:
    return "once" if len(gaps) == 1 else f"{len(gaps)} times"


def _came_together(intervals: Array, gap: int, usual: float) -> bool:
    """Whether the setpoints that were due during a gap followed it closely."""
    missing, after = intervals[gap] - usual, gap + 1
    while after < len(intervals) and intervals[after] < _TOGETHER * usual:
        missing -= usual - intervals[after]
        after += 1
    return bool(missing < 0.5 * (intervals[gap] - usual))


def _states_late(states: SentStates, interval: Array) -> bool:
    """Whether states that the robot sent in an interval arrived after half of it had passed."""
    begin, end = interval
    inside = (states.time_s > begin) & (states.time_s < end)
    delays = (states.arrived_s - states.time_s)[inside]
    return bool(len(delays) and delays.max() > 0.5 * (end - begin))


def _moments(stream: SetpointStream, intervals: Array, gaps: Iterable[int]) -> str:
    """The longest of these intervals, in the order of time."""
    longest = sorted(sorted(gaps, key=lambda gap: -float(intervals[gap]))[:_LISTED])
    return ", ".join(f"{1e3 * intervals[gap]:.0f} ms at {stream.time_s[gap]:.2f} s" for gap in longest)


# setpoints


def _about_start(stream: SetpointStream, states: SentStates) -> Iterator[StreamFinding]:
    if not len(states.time_s):
        return
    distances = np.abs(stream.values[0] - states.values["actual_q"][0])
    joint = int(np.argmax(distances))
    if distances[joint] > _FAR_RAD:
        yield StreamFinding(
            Cause.PROGRAM,
            f"the first setpoint is {distances[joint]:.2f} rad from the arm ({JOINT_LABELS[joint]}): the arm jumps",
            "read the arm's joints first, and start there; or move to the first setpoint with moveJ",
        )


def _about_setpoints(stream: SetpointStream, timing: StreamTiming) -> Iterator[StreamFinding]:
    changed = _changed(stream)
    moving = _moving(stream, changed)
    repeated = 1.0 - float(np.mean(changed[moving])) if np.any(moving) else 0.0
    distinct_hz = timing.rate_hz * (1.0 - repeated)
    if np.any(moving) and (repeated > _REPEATED or timing.rate_hz < _SLOW_HZ):
        times = f", each about {1.0 / max(1e-6, 1.0 - repeated):.0f} times" if repeated > _REPEATED else ""
        yield StreamFinding(
            Cause.PROGRAM,
            f"while the arm moves, {distinct_hz:.1f} new setpoints per second are sent{times}: a staircase",
            "interpolate between them, and send a new setpoint in every period of the robot (docs/lerobot.md, "
            "Robot.waypoints_j)",
        )
    places = np.flatnonzero(changed) + 1
    if len(places) < 2:
        return
    steps = np.max(np.abs(np.diff(stream.values[places], axis=0)), axis=1)
    usual = timing.interval_ms[0] / 1e3
    # Setpoints that came together were meant for different periods.
    spans = np.maximum(np.diff(stream.time_s[places]), usual * np.diff(places))
    jumps = places[1:][(steps / spans > _FASTEST_RAD_S) & (steps > 10 * np.median(steps))]
    if len(jumps):
        yield StreamFinding(
            Cause.PROGRAM,
            f"{len(jumps)} setpoints are further from the one before than any joint can move: {_jumps(stream, jumps)}"
            f"{_chunks(jumps)}",
            "blend the beginning of each new chunk with the end of the last one, or limit the steps",
        )


def _moving(stream: SetpointStream, changed: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which setpoints have a changed one within half a second."""
    at = stream.time_s[1:]
    changes = at[changed]
    if not len(changes):
        return np.zeros(len(at), dtype=np.bool_)
    after = np.clip(np.searchsorted(changes, at), 0, len(changes) - 1)
    nearest = np.minimum(np.abs(changes[after] - at), np.abs(changes[np.maximum(after - 1, 0)] - at))
    return nearest < 0.5 * _PAUSE_S


def _jumps(stream: SetpointStream, jumps: NDArray[np.int64]) -> str:
    sizes = {at: float(np.max(np.abs(stream.values[at] - stream.values[at - 1]))) for at in jumps.tolist()}
    largest = sorted(sorted(sizes, key=lambda at: -sizes[at])[:_LISTED])
    return ", ".join(f"{sizes[at]:.3f} rad at {stream.time_s[at]:.2f} s" for at in largest)


def _chunks(jumps: NDArray[np.int64]) -> str:
    """What regular distances of the jumps mean."""
    distances = np.diff(jumps)
    if len(distances) < 2:
        return ""
    usual = int(np.median(distances))
    regular = np.mean(np.abs(distances - usual) <= 1) > 0.5
    return f"; they are {usual} setpoints apart, as the ends of a policy's chunks are" if regular else ""


# servoing


def _lag(stream: SetpointStream, states: SentStates) -> tuple[float | None, float]:
    """How far the robot's target is behind the setpoints [s], and how much further at the end than at the beginning."""
    first, second = (_delay(stream, states, half) for half in (0, 1))
    grown = 0.0 if first is None or second is None else second - first
    return _delay(stream, states, None), grown


def _delay(stream: SetpointStream, states: SentStates, half: int | None) -> float | None:
    """The delay with which the setpoints resemble the target most [s]; None while hardly anything moves."""
    middle = (stream.time_s[0] + stream.time_s[-1]) / 2
    inside = (states.time_s > stream.time_s[0] + _LONGEST_LAG_S) & (states.time_s < stream.time_s[-1])
    if half is not None:
        inside &= (states.time_s > middle) if half else (states.time_s <= middle)
    if np.count_nonzero(inside) < _WINDOW:
        return None
    times, target = states.time_s[inside], states.values["target_q"][inside]
    if float(np.max(np.ptp(target, axis=0))) < 0.02:
        return None
    delays = np.arange(0.0, _LONGEST_LAG_S, _GRID_S)
    errors = [float(np.sum((_held(stream.time_s, stream.values, times - delay) - target) ** 2)) for delay in delays]
    return float(delays[int(np.argmin(errors))])


def _about_servoing(stream: SetpointStream, lag_s: float | None, backlog_s: float) -> Iterator[StreamFinding]:
    if lag_s is None:
        return
    if backlog_s > _BACKLOG_S:
        yield StreamFinding(
            Cause.PROGRAM,
            f"the robot's target falls further and further behind the setpoints: by {1e3 * backlog_s:.0f} ms more in "
            "the second half",
            "setpoints are sent faster than the robot takes them, one per period: send at the robot's rate",
        )
    elif stream.servo is not None:
        lookahead_s, gain = stream.servo
        expected = 0.3 * lookahead_s + 0.7 / np.sqrt(max(gain, 1.0))  # docs/reference/motion.md
        if lag_s > _EXPECTED * expected + _SLACK_S:
            yield StreamFinding(
                Cause.CONTROLLER,
                f"the robot's target is {1e3 * lag_s:.0f} ms behind the setpoints; servoj with lookahead_time "
                f"{lookahead_s:g} and gain {gain:g} takes about {1e3 * expected:.0f} ms",
                "something between the program and servoj holds setpoints back: a queue, or a control script that runs "
                "less often than once per period",
            )


# forms of the motion


def _forms(stream: SetpointStream, timing: StreamTiming, states: SentStates | None) -> Iterator[MotionForm]:
    grid = np.arange(stream.time_s[0], stream.time_s[-1], _GRID_S)
    if len(grid) <= 2 * _WINDOW:
        return
    even = _evenly_spaced(stream, timing.interval_ms[0] / 1e3)
    yield _form("setpoints, evenly spaced", interpolated(np.arange(even[0], even[-1], _GRID_S), even, stream.values))
    yield _form("setpoints, as sent", _held(stream.time_s, stream.values, grid))
    if states is None or len(states.time_s) < 2:
        return
    grid = grid[(grid >= states.time_s[0]) & (grid <= states.time_s[-1])]
    for name, field in (("robot's target", "target_q"), ("arm", "actual_q")):
        if field in states.values and len(grid) > 2 * _WINDOW:
            yield _form(name, interpolated(grid, states.time_s, states.values[field]))


def _unavoidable(stream: SetpointStream, timing: StreamTiming) -> float:
    """The roughness of evenly spaced setpoints, each of which is held until the next one [mrad]."""
    even = _evenly_spaced(stream, timing.interval_ms[0] / 1e3)
    grid = np.arange(0.0, even[-1], _GRID_S)
    return _form("", _held(even, stream.values, grid)).rms_mrad if len(grid) > 2 * _WINDOW else 0.0


def _evenly_spaced(stream: SetpointStream, interval: float) -> Array:
    """Times at which the setpoints would have been sent without delays; pauses stay."""
    intervals = np.diff(stream.time_s)
    return np.concatenate(([0.0], np.cumsum(np.where(intervals < _PAUSE_S, interval, intervals))))


def _held(time_s: Array, values: Array, grid: Array) -> Array:
    """The last value before each time."""
    held: Array = values[np.clip(np.searchsorted(time_s, grid, side="right") - 1, 0, len(values) - 1)]
    return held


def _form(name: str, path: Array) -> MotionForm:
    rough = 1e3 * _roughness(path)
    rms = np.sqrt(np.mean(rough**2, axis=0))
    joint = int(np.argmax(rms))
    # Over the window, so that single steps do not count as speed.
    speed = np.max(np.abs(path[_WINDOW:] - path[:-_WINDOW]), initial=0.0) / (_WINDOW * _GRID_S)
    return MotionForm(name, float(speed), float(rms[joint]), float(np.max(np.abs(rough))), JOINT_LABELS[joint])


def _roughness(path: Array) -> Array:
    """Distance of each value from the parabola that fits its surroundings best, (n, joints) [rad]."""
    offsets = np.arange(-_WINDOW, _WINDOW + 1) / _WINDOW
    weights = np.linalg.pinv(np.vander(offsets, 3))[-1]  # the fitted value in the middle
    return np.stack([column[_WINDOW:-_WINDOW] - np.convolve(column, weights, "valid") for column in path.T], axis=1)


_ADDED: Final = (
    (Cause.PROGRAM, "the setpoints themselves are rough", "smooth the program's or the policy's output"),
    (Cause.PROGRAM, "their timing makes the setpoints rough", "see the findings about timing and repetition"),
    (
        Cause.CONTROLLER,
        "servoing makes the motion rougher than the setpoints",
        "lower servoj's gain or raise its lookahead_time; call servoj with the time between two setpoints",
    ),
    (Cause.ARM, "the arm is rougher than its target", "check payload and mounting, or avoid the resonance: slower"),
)


def _about_forms(forms: Sequence[MotionForm], held_mrad: float) -> Iterator[StreamFinding]:
    """Findings about the forms that add roughness. held_mrad: what the setpoints have without errors of timing."""
    before = _ROUGH_MRAD
    for number, (form, (cause, text, advice)) in enumerate(zip(forms, _ADDED, strict=False)):
        if number == 1:
            before = max(before, held_mrad)
        if form.rms_mrad > _ROUGHER * before:
            yield StreamFinding(cause, f"{text}: {form.rms_mrad:.1f} mrad, most at the {form.joint}", advice)
        before = max(form.rms_mrad, _ROUGH_MRAD)


def _about_filtering(stream: SetpointStream, forms: Sequence[MotionForm]) -> Iterator[StreamFinding]:
    """What servoj leaves of rough setpoints."""
    if stream.servo is None or len(forms) < 3:
        return
    lookahead_s, gain = stream.servo
    sent, target = forms[1].rms_mrad, forms[2].rms_mrad
    if sent > _ROUGHER * _ROUGH_MRAD and target > _PASSED * sent:
        yield StreamFinding(
            Cause.CONTROLLER,
            f"servoj with lookahead_time {lookahead_s:g} and gain {gain:g} passes {100 * target / sent:.0f} % of the "
            "setpoints' roughness on to the arm",
            "best smooth the setpoints; a longer lookahead_time and a lower gain hide more of it, and lag more",
        )


# states and scripts


def _during(states: SentStates, begin_s: float, end_s: float) -> SentStates:
    inside = (states.time_s >= begin_s) & (states.time_s <= end_s)
    values = {name: values[inside] for name, values in states.values.items()}
    return SentStates(states.time_s[inside], states.arrived_s[inside], values)


def _about_states(states: SentStates) -> Iterator[StreamFinding]:
    fraction = np.ones(len(states.time_s))
    for name in ("speed_scaling", "target_speed_fraction"):
        fraction = np.minimum(fraction, states.values.get(name, fraction))
    if len(fraction) and fraction.min() < 0.99:
        at = states.time_s[int(np.argmin(fraction))]
        yield StreamFinding(
            Cause.CONTROLLER,
            f"the robot runs at {100 * fraction.min():.0f} % speed at {at:.2f} s: each servoj takes longer",
            "set the speed slider to 100 %, and find out what slows the robot down",
        )
    for name, modes, good, why in (
        ("safety_mode", SafetyMode, (SafetyMode.NORMAL, SafetyMode.REDUCED), "the safety system stopped the arm"),
        ("runtime_state", RuntimeState, (RuntimeState.PLAYING,), "the program on the robot ended or was paused"),
    ):
        bad = np.flatnonzero(~np.isin(states.values.get(name, np.full(0, good[0])), good))
        if len(bad):
            first = int(bad[0])
            yield StreamFinding(
                Cause.CONTROLLER,
                f"{name} is {mode_name(modes, states.values[name][first])} at {states.time_s[first]:.2f} s: {why}",
                "the robot's log has the reason",
            )


def _about_scripts(lines: Iterable[ScriptLines]) -> Iterator[StreamFinding]:
    for sent in lines:
        intervals = np.diff(sent.time_s)
        intervals = intervals[intervals < _PAUSE_S]
        if len(intervals) >= _LISTED and len(intervals) / max(float(intervals.sum()), 1e-9) > _LINES_HZ:
            yield StreamFinding(
                Cause.PROGRAM,
                f"{len(sent.time_s)} {sent.command} were sent to port {sent.port} one by one: each is a program that "
                "ends the one before it, so that the arm brakes in between",
                "stream setpoints to one program that keeps running: ur_rtde, the ROS driver, or Robot.waypoints_j",
            )
