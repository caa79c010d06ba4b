"""The Plan tab of the Move screen: drag a target in the 3D view, plan a collision-free path, preview it, execute it."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, dist, hypot, isfinite
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from client.errors import MotionStoppedError, PlanningError
from client.pendant.arm_scene import ArmScene
from client.pendant.page import Page
from client.pendant.scene_monitor import MonitoredScene, links_in, missing_extra
from client.pendant.screens.move_jog import MAX_JOINT_SPEED, MoveSettings
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_inv, pose_trans, quaternion_to_rotvec, rotvec_to_quaternion
from urproto.vectors import as_six

if TYPE_CHECKING:
    from client.planning import PairDistance, Plan, PlanningScene

_AT_GOAL_RAD: Final = 0.002  # targets closer than this need no path
_ACCELERATION_SCALING: Final = 0.14  # of the planner's: gives the 1.4 rad/s2 of the screen's other motions
_MAX_SAMPLES: Final = 200  # of a path, for display
_DIGITS: Final = 4
_CHECK_PERIOD_S: Final = 0.1  # between checks whether the scene has changed
_AT_REST_RAD_S: Final = 1e-3
_MAX_REPLANS: Final = 10  # to one goal (guess)
_MAX_HANDLE_DISTANCE_M: Final = 10.0  # of a handle from the base


@dataclass(frozen=True, slots=True)
class _PlannedPath:
    """A planned path, its goal and its scene. playing: the path with the ghost's motion; moving: without it, while the
    arm moves.
    """

    goal: tuple[float, ...]
    monitored: MonitoredScene
    plan: "Plan"
    playing: dict[str, Any]
    moving: dict[str, Any]


class PlannedMove:
    """The panel of one page: plans from the arm's configuration to the target that is typed or dragged."""

    def __init__(self, page: Page, settings: MoveSettings) -> None:
        self._page = page
        self._settings = settings
        self._visible = False
        self._out_of_reach = False  # the handle is out of reach
        self._busy = False
        self._planned_path: _PlannedPath | None = None
        self._failure: tuple[tuple[float, ...] | None, str] | None = None  # the goal, and why there is no path
        self._collision_cache: tuple[MonitoredScene, tuple[float, ...], list[PairDistance]] | None = None
        page.live.on_message("goal", self._move_target)

    def set_visible(self, visible: bool) -> None:
        """Whether the panel is visible: only then does the view have a handle."""
        self._visible = visible

    def draw(self, scene: ArmScene) -> None:
        """Draw the obstacles, the handle of the target and the path into the view."""
        live = self._page.live
        live.bind(scene, "objects", self._objects)
        live.bind(scene, "goal", self._handle)
        live.bind(scene, "path", self._path)
        ui.run_javascript(f"pendant.plan({scene.id})")

    def panel(self) -> None:
        live = self._page.live
        with ui.element("div").classes("plan-texts"):
            text = live.text(lambda station: self._status(station)[1], "plan-status")
            text.props("role=status data-testid=plan-status")
            live.bind(text, "state", lambda station: self._status(station)[0])
            live.text(_source, "plan-note").props("data-testid=plan-source")
            if missing := missing_extra():
                ui.label(missing).classes("plan-note plan-missing").props("data-testid=plan-missing")
        with ui.row().classes("target-buttons"):
            present = ui.button("Present", icon="my_location", on_click=self._reset)
            present.props("flat no-caps data-testid=plan-present")
            ui.space()
            plan = ui.button("Plan", icon="route", on_click=self._page.handler(self._plan))
            plan.props("outline no-caps data-testid=plan")
            move = ui.button("Move", icon="near_me", on_click=self._page.handler(self._move))
            move.props("unelevated no-caps data-testid=plan-move")
        live.effect(lambda station: not self._busy, plan.set_enabled)
        live.effect(lambda station: not self._move_refusal(station), move.set_enabled)
        live.bind(move, "title", self._move_refusal)

    # state

    def _scene(self, station: Station) -> MonitoredScene | None:
        return station.planning_scene if self._visible or station.has_surroundings else None

    def _target(self, station: Station) -> tuple[float, ...] | None:
        q: Sequence[float] | None = self._settings.preview or station.values.get("actual_q")
        return None if q is None else tuple(q)

    def _collisions(self, station: Station) -> "list[PairDistance]":
        """Pairs nearer than the padding at the target, deepest first; at the current configuration without one."""
        monitored, q = self._scene(station), self._target(station)
        if monitored is None or q is None:
            return []
        if self._collision_cache is None or self._collision_cache[0] is not monitored or self._collision_cache[1] != q:
            self._collision_cache = (monitored, q, monitored.checker.collisions(q))
        return self._collision_cache[2]

    def _valid_path(self, station: Station) -> _PlannedPath | None:
        """The planned path to this target, unless target or scene have changed since."""
        planned = self._planned_path
        if planned is None or planned.goal != self._settings.preview or planned.monitored is not station.planning_scene:
            return None
        return planned

    def _move_refusal(self, station: Station) -> str:
        reason = station.situation.refusal(Action.MOVE)
        return reason or ("" if self._valid_path(station) is not None else "There is no path yet: press Plan first.")

    def _status(self, station: Station) -> tuple[str, str]:
        """The kind of the status, and its text."""
        if not self._visible:
            return "off", ""
        if station.planning_scene is None:
            problem = station.scene_monitor.problem
            return ("bad", problem) if problem else ("off", "The arm is not known yet.")
        if self._busy:
            return "off", "Planning a path \N{HORIZONTAL ELLIPSIS}"
        if self._out_of_reach:
            return "warn", "The handle is out of reach: the ghost shows how far the arm can go."
        if planned := self._valid_path(station):
            return "good", _summary(planned.plan)
        if self._failure is not None and self._failure[0] == self._settings.preview:
            return "bad", self._failure[1]
        if near := self._collisions(station):
            padding_mm = 1000 * station.planning_scene.scene.padding_m
            return "bad", f"{'; '.join(map(str, near[:3]))}. The required clearance is {padding_mm:g} mm."
        if self._settings.preview is None:
            return "off", "Drag the ball, the arrows or the rings at the tool, or type joint angles, then press Plan."
        return "off", "The target is free: press Plan to plan a path there."

    # drawing

    def _objects(self, station: Station) -> dict[str, Any] | None:
        monitored = self._scene(station)
        if monitored is None:
            return None
        red = {name for pair in self._collisions(station) for name in (pair.one, pair.other)}
        return {"objects": monitored.objects, "red": sorted(red)}

    def _handle(self, station: Station) -> dict[str, Any] | None:
        monitored, q = self._scene(station), self._target(station)
        if monitored is None or q is None or not self._visible:
            return None
        x, y, z, *turn = monitored.scene.kinematics.forward(q, monitored.tcp_offset)
        return {
            "position": [round(value, _DIGITS) for value in (x, y, z)],
            "quaternion": [round(value, _DIGITS) for value in rotvec_to_quaternion(*turn)],
            "turned": self._settings.feature == "tool",
            "red": links_in(self._collisions(station)) if self._settings.preview is not None else [],
            "far": self._out_of_reach,
        }

    def _path(self, station: Station) -> dict[str, Any] | None:
        planned = self._valid_path(station)
        if planned is None:
            return None
        return planned.moving if station.mover.activity else planned.playing

    # user actions

    def _move_target(self, message: Any) -> None:
        """Move the target with the handle, as far as the arm can reach. Raises ValueError for an invalid message."""
        station = self._page.station
        monitored, q = self._scene(station), self._target(station)
        if message is None or monitored is None or q is None:
            self._out_of_reach = False
            return
        flange = pose_trans(_pose(message), pose_inv(monitored.tcp_offset))
        reached = monitored.scene.kinematics.inverse_near(flange, q, *monitored.scene.model.position_limits)
        self._out_of_reach = reached is None
        if reached is not None:
            self._settings.preview = reached
        if message.get("end"):
            self._out_of_reach = False
            if (target := self._settings.preview) is not None:
                for callback in self._settings.on_target:
                    callback(as_six(target))

    def _reset(self) -> None:
        self._settings.preview = self._planned_path = self._failure = None

    async def _plan(self) -> None:
        station, goal = self._page.station, self._settings.preview
        monitored, start = station.planning_scene, station.values.get("actual_q")
        if monitored is None or start is None:
            reason = station.scene_monitor.problem or "the robot has not reported its model and position yet"
            raise RobotRefused("planning", reason, "wait until it is connected")
        self._planned_path = self._failure = None
        if goal is None or dist(goal, start) < _AT_GOAL_RAD:
            self._failure = (goal, "The arm is already there: drag the handle or type joint angles first.")
            return
        self._busy = True
        try:
            plan = await asyncio.to_thread(_plan_path, monitored.scene, start, goal, self._settings.speed)
        except PlanningError as error:
            self._failure = (goal, str(error))
        else:
            self._planned_path = _planned_path(goal, monitored, plan)
        finally:
            self._busy = False
            station.notify_pages()

    async def _move(self) -> None:
        planned = self._valid_path(self._page.station)
        if planned is None:
            raise RobotRefused("motion", "there is no path to this target", "press Plan first")

        async def follow() -> None:
            await self._follow(planned)
            self._settings.preview = self._planned_path = None

        await self._settings.move(follow)

    async def _follow(self, planned: _PlannedPath) -> None:
        """Follow a path to the goal; replan when an obstacle blocks it. Raises PlanningError, MotionStoppedError."""
        station = self._page.station
        for _ in range(_MAX_REPLANS):
            blocked = await self._follow_monitored(planned)
            if not blocked:
                return
            stop_count = station.mover.stop_count
            self._page.show_message(f"{blocked}. Planning another path.")
            while any(abs(speed) > _AT_REST_RAD_S for speed in station.values.get("actual_qd", ())):
                await asyncio.sleep(_CHECK_PERIOD_S)
            planned = self._planned_path = await self._replan(planned)
            if station.mover.stop_count != stop_count:
                raise MotionStoppedError("Moving as planned", "it was stopped")
        raise PlanningError(
            f"{_MAX_REPLANS} paths were blocked one after the other: plan again when the scene no longer changes"
        )

    async def _follow_monitored(self, planned: _PlannedPath) -> str:
        """Have the arm follow a path. If an obstacle blocks it, stop the arm and return the reason."""
        station, monitored = self._page.station, planned.monitored
        follow = asyncio.ensure_future(station.mover.execute(planned.plan))
        try:
            while not (await asyncio.wait({follow}, timeout=_CHECK_PERIOD_S))[0]:
                now, q = station.planning_scene, station.values.get("actual_q")
                if now is None or now is monitored or q is None:
                    continue
                monitored = now
                blocked = await asyncio.to_thread(_blocking_reason, now, planned.plan, q)
                if blocked and not follow.done():
                    stop_count = station.mover.stop_count
                    await station.mover.stop()
                    with suppress(MotionStoppedError):
                        await follow
                    if station.mover.stop_count > stop_count + 1:  # Stop was pressed, too
                        raise MotionStoppedError("Moving as planned", "it was stopped")
                    return blocked
            await follow
        finally:
            follow.cancel()
        return ""

    async def _replan(self, planned: _PlannedPath) -> _PlannedPath:
        """Plan to the same goal from the current configuration, in the current scene. Raises PlanningError."""
        station = self._page.station
        monitored = station.planning_scene or planned.monitored
        start = as_six(station.values["actual_q"])
        plan = await asyncio.to_thread(_plan_path, monitored.scene, start, planned.goal, self._settings.speed)
        return _planned_path(planned.goal, monitored, plan)


def _blocking_reason(monitored: MonitoredScene, plan: "Plan", q_rad: Sequence[float]) -> str:
    from client.planning.collisions import blocking_reason

    return blocking_reason(monitored.checker, plan.trajectory, q_rad)


def _plan_path(scene: "PlanningScene", start: Joints, goal: tuple[float, ...], speed: float) -> "Plan":
    """Plan with joint speeds no higher than those of the screen's other motions at this share of their speed."""
    from client.planning import JointGoal, Planner

    planner = Planner(scene)
    velocity = min(1.0, speed * MAX_JOINT_SPEED / max(planner.limits.velocity))
    return planner.plan(start, JointGoal(goal), velocity_scaling=velocity, acceleration_scaling=_ACCELERATION_SCALING)


def _planned_path(goal: tuple[float, ...], monitored: MonitoredScene, plan: "Plan") -> _PlannedPath:
    step = ceil(len(plan.trajectory.q) / _MAX_SAMPLES)
    samples = [
        [round(float(angle), _DIGITS) for angle in q] for q in (*plan.trajectory.q[:-1:step], plan.trajectory.q[-1])
    ]
    forward = monitored.scene.kinematics.forward
    points = [[round(value, _DIGITS) for value in forward(q, monitored.tcp_offset)[:3]] for q in samples]
    playing = {"points": points, "angles": samples, "duration": plan.duration_s}
    return _PlannedPath(goal, monitored, plan, playing, {**playing, "angles": []})


def _summary(plan: "Plan") -> str:
    corners = len(plan.path) - 2
    description = (
        f"{corners} corner{'s' if corners > 1 else ''}, by {plan.planner}" if corners else "straight to the goal"
    )
    planning_s = plan.search_s + plan.shortcutting_s + plan.parameterisation_s
    return f"A path of {plan.duration_s:.1f} s, {description}; planning took {1000 * planning_s:.0f} ms."


def _source(station: Station) -> str:
    """Where the obstacles come from, since a user who trusts a path needs to know."""
    if station.scene_monitor.file is not None:
        return f"Obstacles: the objects of {station.scene_monitor.file.name}, and the arm itself."
    if station.emulator.available:
        return "Obstacles: the objects of the emulator's world, and the arm itself."
    return (
        "Obstacles: the arm itself only, since a robot does not report what is around it. To add objects, start "
        "ur-client pendant with --scene FILE, a world file."
    )


def _pose(message: Any) -> Pose:
    """The pose of a handle, in the base frame."""
    if not isinstance(message, dict):
        raise ValueError("a handle must send its pose")
    x, y, z = _numbers(message.get("position"), 3)
    a, b, c, d = _numbers(message.get("quaternion"), 4)
    size = hypot(a, b, c, d)
    if size < 0.5 or max(abs(x), abs(y), abs(z)) > _MAX_HANDLE_DISTANCE_M:
        raise ValueError("the pose is outside the range of a handle")
    return (x, y, z, *quaternion_to_rotvec(a / size, b / size, c / size, d / size))


def _numbers(message: Any, count: int) -> list[float]:
    if not isinstance(message, list) or len(message) != count:
        raise ValueError(f"{count} finite numbers are expected")
    numbers = [float(value) for value in message if isinstance(value, int | float)]
    if len(numbers) != count or not all(map(isfinite, numbers)):
        raise ValueError(f"{count} finite numbers are expected")
    return numbers
