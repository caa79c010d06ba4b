"""Targets that are dragged in the 3D view, and ways there around what is in the way: planned, seen, then taken."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, dist, hypot, isfinite
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from client.errors import MotionStoppedError, PlanningError
from client.pendant.arena import Arena, lacking, red_links
from client.pendant.arm_scene import ArmScene
from client.pendant.page import Page
from client.pendant.screens.move_jog import JOINT_TOP, MoveSettings
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.robots import Joints
from urproto.robots.pose import Pose, pose_inv, pose_trans, quaternion_to_rotvec, rotvec_to_quaternion

if TYPE_CHECKING:
    from client.planning import Nearness, Plan, PlanningScene

_THERE_RAD: Final = 0.002  # nearer targets need no way
_RAMP: Final = 0.14  # of planning's accelerations: those of the motions beside it, 1.4 rad/s2
_MOST_SAMPLES: Final = 200  # of a way, for the picture
_DIGITS: Final = 4
_LOOK_S: Final = 0.1  # between looks whether the scene has changed
_STILL_RAD_S: Final = 1e-3
_MOST_WAYS: Final = 10  # one after the other to one goal (guess)
_FARTHEST_M: Final = 10.0  # of a handle


@dataclass(frozen=True, slots=True)
class _Found:
    """A way, and for which goal it was found where. moving: without what plays along, for when the arm itself moves."""

    goal: tuple[float, ...]
    arena: Arena
    plan: "Plan"
    playing: dict[str, Any]
    moving: dict[str, Any]


class PlannedMove:
    """Of one page: from where the arm stands to the target that is typed or dragged."""

    def __init__(self, page: Page, settings: MoveSettings) -> None:
        self._page = page
        self._settings = settings
        self._looked_at = False
        self._far = False  # the handle is out of reach
        self._busy = False
        self._found: _Found | None = None
        self._failed: tuple[tuple[float, ...] | None, str] | None = None  # the goal, and why there is no way
        self._pairs: tuple[Arena, tuple[float, ...], list[Nearness]] | None = None
        page.live.hear("goal", self._drag)

    def look(self, looked_at: bool) -> None:
        """Whether a person looks at the panel now: only then is there a handle in the view."""
        self._looked_at = looked_at

    def draw(self, scene: ArmScene) -> None:
        """Into the view: what stands around the arm, the handle of the target, the way."""
        live = self._page.live
        live.bind(scene, "things", self._things)
        live.bind(scene, "goal", self._handle)
        live.bind(scene, "way", self._way)
        ui.run_javascript(f"pendant.plan({scene.id})")

    def panel(self) -> None:
        """What is the matter, and the buttons."""
        live = self._page.live
        with ui.element("div").classes("plan-texts"):
            text = live.text(lambda station: self._status(station)[1], "plan-status")
            text.props("role=status data-testid=plan-status")
            live.bind(text, "state", lambda station: self._status(station)[0])
            live.text(_source, "plan-note").props("data-testid=plan-source")
            if lack := lacking():
                ui.label(lack).classes("plan-note plan-lacking").props("data-testid=plan-lacking")
        with ui.row().classes("target-buttons"):
            present = ui.button("Present", icon="my_location", on_click=self._reset)
            present.props("flat no-caps data-testid=plan-present")
            ui.space()
            plan = ui.button("Plan", icon="route", on_click=self._page.doing(self._plan))
            plan.props("outline no-caps data-testid=plan")
            move = ui.button("Move", icon="near_me", on_click=self._page.doing(self._move))
            move.props("unelevated no-caps data-testid=plan-move")
        live.effect(lambda station: not self._busy, plan.set_enabled)
        live.effect(lambda station: not self._why_not(station), move.set_enabled)
        live.bind(move, "title", self._why_not)

    # what is known

    def _arena(self, station: Station) -> Arena | None:
        return station.arena if self._looked_at or station.has_surroundings else None

    def _target(self, station: Station) -> tuple[float, ...] | None:
        q: Sequence[float] | None = self._settings.preview or station.values.get("actual_q")
        return None if q is None else tuple(q)

    def _near(self, station: Station) -> "list[Nearness]":
        """Pairs that would be nearer than the padding at the target, deepest first; of the arm itself without one."""
        arena, q = self._arena(station), self._target(station)
        if arena is None or q is None:
            return []
        if self._pairs is None or self._pairs[0] is not arena or self._pairs[1] != q:
            self._pairs = (arena, q, arena.checker.collisions(q))
        return self._pairs[2]

    def _way_found(self, station: Station) -> _Found | None:
        """The way to this target, if nothing has changed since it was found."""
        found = self._found
        if found is None or found.goal != self._settings.preview or found.arena is not station.arena:
            return None
        return found

    def _why_not(self, station: Station) -> str:
        why = station.situation.why_not(Action.MOVE)
        return why or ("" if self._way_found(station) is not None else "There is no way yet: press Plan first.")

    def _status(self, station: Station) -> tuple[str, str]:
        """Of which kind it is, and the text."""
        if not self._looked_at:
            return "off", ""
        if station.arena is None:
            problem = station.arenas.problem
            return ("bad", problem) if problem else ("off", "The arm is not known yet.")
        if self._busy:
            return "off", "Looking for a way \N{HORIZONTAL ELLIPSIS}"
        if self._far:
            return "warn", "The handle is out of reach: the ghost shows how far the arm gets."
        if found := self._way_found(station):
            return "good", _described(found.plan)
        if self._failed is not None and self._failed[0] == self._settings.preview:
            return "bad", self._failed[1]
        if near := self._near(station):
            padding_mm = 1000 * station.arena.scene.padding_m
            return "bad", f"{'; '.join(map(str, near[:3]))}. {padding_mm:g} mm are to be kept."
        if self._settings.preview is None:
            return "off", "Drag the ball, the arrows or the rings at the tool, or type joint angles: then Plan."
        return "off", "The target is free: press Plan for a way there."

    # what is drawn

    def _things(self, station: Station) -> dict[str, Any] | None:
        arena = self._arena(station)
        if arena is None:
            return None
        red = {name for pair in self._near(station) for name in (pair.one, pair.other)}
        return {"things": arena.things, "red": sorted(red)}

    def _handle(self, station: Station) -> dict[str, Any] | None:
        arena, q = self._arena(station), self._target(station)
        if arena is None or q is None or not self._looked_at:
            return None
        x, y, z, *turn = arena.scene.kinematics.forward(q, arena.tcp_offset)
        return {
            "position": [round(value, _DIGITS) for value in (x, y, z)],
            "quaternion": [round(value, _DIGITS) for value in rotvec_to_quaternion(*turn)],
            "turned": self._settings.feature == "tool",
            "red": red_links(self._near(station)) if self._settings.preview is not None else [],
            "far": self._far,
        }

    def _way(self, station: Station) -> dict[str, Any] | None:
        found = self._way_found(station)
        if found is None:
            return None
        return found.moving if station.mover.doing else found.playing

    # what a person does

    def _drag(self, said: Any) -> None:
        """The handle, as far as the arm gets there. Raises ValueError for what no handle says."""
        station = self._page.station
        arena, q = self._arena(station), self._target(station)
        if said is None or arena is None or q is None:
            self._far = False
            return
        flange = pose_trans(_pose(said), pose_inv(arena.tcp_offset))
        reached = arena.scene.kinematics.inverse_near(flange, q, *arena.scene.model.position_limits)
        self._far = reached is None
        if reached is not None:
            self._settings.preview = reached
        if said.get("end"):
            self._far = False
            if (target := self._settings.preview) is not None:
                for tell in self._settings.on_target:
                    tell(_six(target))

    def _reset(self) -> None:
        self._settings.preview = self._found = self._failed = None

    async def _plan(self) -> None:
        station, goal = self._page.station, self._settings.preview
        arena, start = station.arena, station.values.get("actual_q")
        if arena is None or start is None:
            why = station.arenas.problem or "the robot has not said yet which arm it is and where"
            raise RobotRefused("planning", why, "wait until it is connected")
        self._found = self._failed = None
        if goal is None or dist(goal, start) < _THERE_RAD:
            self._failed = (goal, "The arm is there already: drag the handle, or type joint angles, first.")
            return
        self._busy = True
        try:
            plan = await asyncio.to_thread(_plan_way, arena.scene, start, goal, self._settings.speed)
        except PlanningError as error:
            self._failed = (goal, str(error))
        else:
            self._found = _found(goal, arena, plan)
        finally:
            self._busy = False
            station.wake()

    async def _move(self) -> None:
        found = self._way_found(self._page.station)
        if found is None:
            raise RobotRefused("motion", "there is no way for this target", "press Plan first")

        async def follow() -> None:
            await self._follow(found)
            self._settings.preview = self._found = None

        await self._settings.move(follow)

    async def _follow(self, found: _Found) -> None:
        """To the goal, on another way when something comes into this one. Raises PlanningError, MotionStoppedError."""
        station = self._page.station
        for _ in range(_MOST_WAYS):
            blocked = await self._watched(found)
            if not blocked:
                return
            stops = station.mover.stops
            self._page.tell(f"{blocked}. Looking for another way.")
            while any(abs(speed) > _STILL_RAD_S for speed in station.values.get("actual_qd", ())):
                await asyncio.sleep(_LOOK_S)
            found = self._found = await self._another(found)
            if station.mover.stops != stops:
                raise MotionStoppedError("Moving as planned", "it was stopped")
        raise PlanningError(f"{_MOST_WAYS} ways were blocked one after the other: plan again when the scene is quiet")

    async def _watched(self, found: _Found) -> str:
        """Let the arm take a way. If something comes into it, the arm is stopped, and this says what."""
        station, arena = self._page.station, found.arena
        follow = asyncio.ensure_future(station.mover.follow(found.plan))
        try:
            while not (await asyncio.wait({follow}, timeout=_LOOK_S))[0]:
                now, q = station.arena, station.values.get("actual_q")
                if now is None or now is arena or q is None:
                    continue
                arena = now
                blocked = await asyncio.to_thread(_blocked, now, found.plan, q)
                if blocked and not follow.done():
                    stops = station.mover.stops
                    await station.mover.stop()
                    with suppress(MotionStoppedError):
                        await follow
                    if station.mover.stops > stops + 1:  # somebody pressed Stop, too
                        raise MotionStoppedError("Moving as planned", "it was stopped")
                    return blocked
            await follow
        finally:
            follow.cancel()
        return ""

    async def _another(self, found: _Found) -> _Found:
        """A way to the same goal from where the arm stands, in the scene as it is now. Raises PlanningError."""
        station = self._page.station
        arena = station.arena or found.arena
        start = _six(station.values["actual_q"])
        plan = await asyncio.to_thread(_plan_way, arena.scene, start, found.goal, self._settings.speed)
        return _found(found.goal, arena, plan)


def _blocked(arena: Arena, plan: "Plan", q_rad: Sequence[float]) -> str:
    from client.planning.watching import in_the_way

    return in_the_way(arena.checker, plan.timed, q_rad)


def _plan_way(scene: "PlanningScene", start: Joints, goal: tuple[float, ...], speed: float) -> "Plan":
    """No joint faster than by the other motions of the screen at this share of their speed."""
    from client.planning import JointGoal, Planner

    planner = Planner(scene)
    velocity = min(1.0, speed * JOINT_TOP / max(planner.limits.velocity))
    return planner.plan(start, JointGoal(goal), velocity_scaling=velocity, acceleration_scaling=_RAMP)


def _found(goal: tuple[float, ...], arena: Arena, plan: "Plan") -> _Found:
    every = ceil(len(plan.timed.q) / _MOST_SAMPLES)
    samples = [[round(float(angle), _DIGITS) for angle in q] for q in (*plan.timed.q[:-1:every], plan.timed.q[-1])]
    forward = arena.scene.kinematics.forward
    points = [[round(value, _DIGITS) for value in forward(q, arena.tcp_offset)[:3]] for q in samples]
    playing = {"points": points, "angles": samples, "duration": plan.duration_s}
    return _Found(goal, arena, plan, playing, {**playing, "angles": []})


def _described(plan: "Plan") -> str:
    corners = len(plan.way) - 2
    how = f"{corners} corner{'s' if corners > 1 else ''}, by {plan.planner}" if corners else "straight ahead"
    took = plan.search_s + plan.shortening_s + plan.timing_s
    return f"A way of {plan.duration_s:.1f} s, {how}; it took {1000 * took:.0f} ms to find."


def _source(station: Station) -> str:
    """Where it is from what is planned around: whoever trusts a way wants to know."""
    if station.arenas.file is not None:
        return f"Around what {station.arenas.file.name} has, and the arm itself."
    if station.emulator.available:
        return "Around the things of the emulator's world, and the arm itself."
    return (
        "Around the arm itself only: a robot does not say what stands around it. ur-client pendant --scene FILE takes "
        "a world file."
    )


def _pose(said: Any) -> Pose:
    """Of a handle, in the base frame."""
    if not isinstance(said, dict):
        raise ValueError("a handle says where it is")
    x, y, z = _numbers(said.get("position"), 3)
    a, b, c, d = _numbers(said.get("quaternion"), 4)
    size = hypot(a, b, c, d)
    if size < 0.5 or max(abs(x), abs(y), abs(z)) > _FARTHEST_M:
        raise ValueError("no handle is there")
    return (x, y, z, *quaternion_to_rotvec(a / size, b / size, c / size, d / size))


def _numbers(said: Any, count: int) -> list[float]:
    if not isinstance(said, list) or len(said) != count:
        raise ValueError(f"{count} numbers were to come")
    numbers = [float(value) for value in said if isinstance(value, int | float)]
    if len(numbers) != count or not all(map(isfinite, numbers)):
        raise ValueError(f"{count} numbers were to come")
    return numbers


def _six(q: Sequence[float]) -> Joints:
    a, b, c, d, e, f = q
    return (a, b, c, d, e, f)
