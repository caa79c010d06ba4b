"""Every public call refuses values that it cannot use, with the library's own error, before it sends anything."""

import asyncio
import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy
import pytest
from driver_rig import HOST

from client import (
    AsyncRobot,
    DashboardClient,
    ModbusClient,
    PrimaryClient,
    RealtimeClient,
    RobotAPIClient,
    RTDEClient,
    ToolCommunication,
    URDriver,
    dashboard,
    dashboard_commands,
    points,
    robotapi,
)
from client.connection import FlowMethod
from client.driver import DriverConfig
from client.errors import PlanningError, SceneError
from client.primary import PrimaryCore
from client.quantities import QUANTITIES, Quantity, check_of, checked_call
from tests.rows import each_row
from urproto.errors import LocalProtocolError, URError
from urproto.external_control import Query, to_words
from urproto.text import quoted

COMPONENTS = ("kinematics", "dynamics", "contact", "force", "planning", "io", "programs", "dashboard")
POINTS = [points.spline, *(member for _, member in inspect.getmembers(points, inspect.isfunction))]
COMMANDS = [
    member
    for module in (dashboard_commands, robotapi)
    for _, member in inspect.getmembers(module, inspect.isfunction)
    if member.__module__ == module.__name__
]
PORTS = {
    ModbusClient: lambda: ModbusClient(HOST),
    RTDEClient: lambda: RTDEClient(HOST, ["timestamp"]),
    RealtimeClient: lambda: RealtimeClient(HOST),
}
PLANNING = find_spec("coal") is not None
BY_THE_CALL = {  # not by their signature
    *("moves", "points", "frame", "outputs", "inputs", "values"),  # tested below
    *("goal", "goals", "scene", "items", "plan", "waypoints"),  # of planning: tested below
    "failing",
}
GIVEN = ("Goal", "GoalSet", "Constraint", "Constraints", "SequenceItem", "CartesianLimits")  # what planning is given
IMPLICIT = ("self", "cls")
SEVERAL = ("waypoints", "words")
HUGE = 10**400
NOT_NUMBERS = ("abc", "abcdef", None, object(), math.nan, HUGE, -HUGE, 1e300, {}, 1j)
GOOD: dict[Any, Any] = {
    **{"moves": [], "points": [], "items": [], "outputs": ["timestamp"], "model": "ur3"},
    **{str: "x", bool: True, Query: Query.STEADY, int: 1, float: 1.0, Path: Path("x")},
}


def calls() -> Iterator[tuple[str, Callable[[], Callable[..., Any]], inspect.Signature]]:
    """Name, how to get it from an object that is not connected, and signature of every public call."""

    def of(title: str, kind: type, owner: Callable[[], Any]) -> Iterator[Any]:
        for name, member in inspect.getmembers(kind):
            function = inspect.unwrap(member) if callable(member) else None
            if not name.startswith("_") and inspect.isfunction(function):
                yield f"{title}.{name}", lambda name=name: getattr(owner(), name), inspect.signature(function)

    for kind, owner in PORTS.items():
        for name, flow in inspect.getmembers(kind, lambda member: isinstance(member, FlowMethod)):
            get = lambda name=name, owner=owner: getattr(owner(), name)  # noqa: E731
            yield f"{kind.__name__}.{name}", get, inspect.signature(flow._method)
    yield from of("PrimaryCore", PrimaryCore, PrimaryCore)
    for kind in (*PORTS, PrimaryClient, DashboardClient, RobotAPIClient, ToolCommunication):
        yield kind.__name__, lambda kind=kind: kind, inspect.signature(kind)
    if PLANNING:
        from client import planning

        scene = planning.PlanningScene("ur3")
        for part in (scene, planning.CollisionChecker(scene), planning.Planner(scene)):
            yield from of(type(part).__name__, type(part), lambda part=part: part)
        for kind in vars(planning).values():
            if inspect.isclass(kind) and (kind.__name__.endswith(GIVEN) or kind in (type(scene), planning.Planner)):
                yield kind.__name__, lambda kind=kind: kind, inspect.signature(kind)
    yield from of("driver", URDriver, lambda: URDriver(HOST))
    yield from of("robot", AsyncRobot, lambda: AsyncRobot(HOST))
    for part in COMPONENTS:
        kind = type(getattr(AsyncRobot(HOST), part))
        yield from of(part, kind, lambda part=part: getattr(AsyncRobot(HOST), part))
    for function in (*POINTS, *COMMANDS):
        if not function.__name__.startswith("_") and function is not checked_call:
            yield (
                f"{function.__module__}.{function.__name__}",
                lambda function=function: function,
                inspect.signature(function),
            )


CALLS = list(calls())
CHECKED = [
    pytest.param(get, signature, parameter, id=f"{name}-{parameter.name}")
    for name, get, signature in CALLS
    for parameter in signature.parameters.values()
    if parameter.name not in IMPLICIT and check_of(parameter) is not None
]


def test_every_parameter_has_a_check():
    unchecked = {
        f"{name}({parameter})"
        for name, _, signature in CALLS
        for parameter in signature.parameters.values()
        if parameter.name not in BY_THE_CALL | {*IMPLICIT, "options", "args"} and check_of(parameter) is None
    }
    assert not unchecked


def quantity_of(parameter: inspect.Parameter) -> Quantity | None:
    plain = isinstance(parameter.annotation, type) and parameter.annotation not in (int, float)
    return None if plain else QUANTITIES.get(parameter.name)


def good(parameter: inspect.Parameter) -> Any:
    if quantity := quantity_of(parameter):
        number = min(max(1, quantity.low), quantity.high)
        one = [number] * quantity.size if quantity.size else number
        return [one] if parameter.name in SEVERAL else one
    if parameter.name in GOOD:
        return GOOD[parameter.name]
    if get_origin(parameter.annotation) is Callable:
        return bool
    kind = next((kind for kind in get_args(parameter.annotation) if isinstance(kind, type)), parameter.annotation)
    if isinstance(kind, type):
        return GOOD[kind] if kind in GOOD else kind.__new__(kind)
    return "x" if "str" in str(kind) else dashboard.PLAY


def bad(parameter: inspect.Parameter) -> Iterator[Any]:
    quantity = quantity_of(parameter)
    optional = "None" in str(parameter.annotation)
    if quantity is None and parameter.annotation not in (int, float):
        yield from (value for value in (5.5, object(), None) if not (optional and value is None))
        return
    fitting_too = [*([None] if optional else []), *([{}] if parameter.name in SEVERAL else [])]
    fitting_too += [1e300] if quantity is None and parameter.annotation is float else []
    yield from (value for value in NOT_NUMBERS if value not in fitting_too)
    if parameter.name in SEVERAL:
        yield from ([wrong] for wrong in NOT_NUMBERS)
    elif quantity is None or not quantity.size:
        yield from ([1.0], -math.inf)
    else:
        fitting = good(parameter)
        yield from ([], fitting[1:], [*fitting, *fitting[:1]])
        for wrong in NOT_NUMBERS:
            yield from ([*fitting[1:], wrong], [wrong, *fitting[1:]])


def run(call: Callable[..., Any], args: list[Any], kwargs: dict[str, Any]) -> None:
    result = call(*args, **kwargs)
    if inspect.iscoroutine(result):
        asyncio.run(result)


@each_row(("get", "signature", "parameter"), CHECKED)
def test_bad_values_are_refused_before_anything_is_sent(get, signature, parameter):
    call, given = get(), [one for one in signature.parameters.values() if one.name not in IMPLICIT]
    for value in bad(parameter):
        args, named = [], {}
        for one in given:
            others = one.kind in (one.VAR_POSITIONAL, one.VAR_KEYWORD)
            if one is parameter:
                argument = value
            else:
                argument = good(one) if one.default is one.empty and not others else one.default
            if one.kind is one.KEYWORD_ONLY:
                named[one.name] = argument
            elif one is parameter or not others:
                args.append(argument)
        with pytest.raises(URError) as refusal:
            run(call, args, named)
        culprit = value[0] if parameter.name in SEVERAL and isinstance(value, list) else value
        assert str(refusal.value).endswith(f"not {quoted(culprit)}")  # and not another argument


@each_row("moves", [5, None, ["abc"], [None], "abc", [points.movej([0.0] * 6), math.nan]])
@each_row("call", [AsyncRobot(HOST).sequence, URDriver(HOST).execute, URDriver(HOST).stream])
def test_a_trajectory_of_something_else_is_refused(call, moves):
    with pytest.raises(LocalProtocolError):
        asyncio.run(call(moves))


@each_row("call", ["servoj", "servo_pose", "speedj", "speedl"])
def test_a_timeout_that_the_robot_does_not_keep_is_refused(call):
    with pytest.raises(LocalProtocolError, match=r"waits at most 0\.2 s for the next setpoint, not 0\.5"):
        getattr(URDriver(HOST), call)([0.0] * 6, 0.5)


@each_row("names", [5, None, "timestamp", b"x", [5], math.nan])
def test_recipes_of_something_else_are_refused(names):
    with pytest.raises(LocalProtocolError):
        RTDEClient(HOST, names)
    with pytest.raises(LocalProtocolError):
        RTDEClient(HOST, [], names if names == [5] else [names])


@pytest.mark.skipif(not PLANNING, reason="planning is not installed")
def test_planning_of_something_else_is_refused():
    from client import planning

    scene, start = planning.PlanningScene("ur3"), [0.0, -1.5, 0.0, -1.5, 0.0, 0.0]
    planner = planning.Planner(scene)
    shapes = [planning.Box((1.0, math.nan, 1.0)), planning.Sphere("x"), planning.Cylinder(0.1, None)]
    shapes += [planning.Mesh("file"), planning.Hull([[0.0] * 3] * 3 + ["abc"]), planning.Hull(5)]
    for shape in shapes:
        with pytest.raises(SceneError, match="part: "):
            scene.add("part", shape)
    for items in (5, None, "abc", [], [None], [planning.JointGoal(start)]):
        with pytest.raises(PlanningError):
            planner.plan_sequence(start, items)
    for goals in (5, None, [], [None], ["abc"]):
        with pytest.raises(PlanningError):
            planning.GoalSet(goals)
    for limit in ("abc", None, 5.0, numpy.zeros(6), numpy.array([math.nan] * 6)):
        with pytest.raises(PlanningError):
            planning.Limits(limit, limit, limit)


@each_row("frame", [5, None, "world", [0.0] * 5, [math.nan] * 6])
def test_a_frame_that_is_none_is_refused(frame):
    with pytest.raises(LocalProtocolError):
        asyncio.run(AsyncRobot(HOST).jog([0.0] * 6, frame=frame))


@each_row("name", [one.name for one in fields(DriverConfig) if one.name in QUANTITIES])
def test_options_are_checked_as_well(name):
    for value in ("abc", math.nan, -1.0, [1.0]):
        with pytest.raises(LocalProtocolError):
            AsyncRobot(HOST, **{name: value})


def test_values_of_numpy_are_accepted():
    points.movej(numpy.zeros(6), v=numpy.float32(1.0))
    QUANTITIES["steps"].check(numpy.int64(3))


def test_messages_name_quantity_unit_and_range():
    def refused(name: str, value: Any) -> str:
        with pytest.raises(LocalProtocolError) as refusal:
            QUANTITIES[name].check(value)
        return str(refusal.value)

    assert refused("cog_m", [50, 0, 0]) == "a position: 3 numbers from -2 to 2 m, not [50, 0, 0]"
    assert refused("speed_m_s", -1) == "a speed: above 0 and up to 20 rad/s or m/s, not -1"
    assert refused("timeout_s", math.nan) == "a time: from 0 to 1e+09 s, not nan"
    assert len(refused("q_rad", ["x" * 1000] * 6)) < 150
    with pytest.raises(LocalProtocolError, match="carries numbers"):
        to_words("abc")
