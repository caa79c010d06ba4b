"""Every public call refuses values that it cannot use, with the library's own error, before it sends anything."""

import asyncio
import inspect
import math
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import Any

import pytest
from driver_rig import HOST

from client import AsyncRobot, URDriver, dashboard, points
from client.driver import DriverConfig
from client.quantities import QUANTITIES, check_of, checked_call
from urproto.errors import LocalProtocolError
from urproto.external_control import Query, to_words
from urproto.text import quoted

COMPONENTS = ("kinematics", "dynamics", "contact", "force", "planning", "io", "programs", "dashboard")
POINTS = [points.spline, *(member for _, member in inspect.getmembers(points, inspect.isfunction))]
BY_THE_CALL = {  # not by their signature
    *("moves", "points", "frame"),  # tested below
    *("goal", "scene", "items", "plan", "waypoints"),  # planning has its own errors, and is loaded on use
}
HUGE = 10**400
NOT_NUMBERS = ("abc", "abcdef", None, object(), math.nan, HUGE, -HUGE, 1e300, {}, 1j)
GOOD = {str: "x", bool: True, Query: Query.STEADY, int: 1, float: 1.0}


def calls() -> Iterator[tuple[str, Callable[[], Callable[..., Any]], inspect.Signature]]:
    """Name, how to get it from an object that is not connected, and signature of every public call."""

    def of(title: str, kind: type, owner: Callable[[], Any]) -> Iterator[Any]:
        for name, member in inspect.getmembers(kind):
            function = inspect.unwrap(member) if callable(member) else None
            if not name.startswith("_") and inspect.isfunction(function):
                yield f"{title}.{name}", lambda name=name: getattr(owner(), name), inspect.signature(function)

    yield from of("driver", URDriver, lambda: URDriver(HOST))
    yield from of("robot", AsyncRobot, lambda: AsyncRobot(HOST))
    for part in COMPONENTS:
        kind = type(getattr(AsyncRobot(HOST), part))
        yield from of(part, kind, lambda part=part: getattr(AsyncRobot(HOST), part))
    for function in POINTS:
        if not function.__name__.startswith("_") and function is not checked_call:
            yield f"points.{function.__name__}", lambda function=function: function, inspect.signature(function)


CALLS = list(calls())
CHECKED = [
    pytest.param(get, signature, parameter, id=f"{name}-{parameter.name}")
    for name, get, signature in CALLS
    for parameter in signature.parameters.values()
    if parameter.name != "self" and check_of(parameter) is not None
]


def test_every_parameter_has_a_check():
    unchecked = {
        f"{name}({parameter})"
        for name, _, signature in CALLS
        for parameter in signature.parameters.values()
        if parameter.name not in BY_THE_CALL | {"self", "options", "args"} and check_of(parameter) is None
    }
    assert not unchecked


def good(parameter: inspect.Parameter) -> Any:
    if quantity := QUANTITIES.get(parameter.name):
        number = min(max(1, quantity.low), quantity.high)
        return [number] * quantity.size if quantity.size else number
    if parameter.name in ("moves", "points"):
        return []
    if parameter.name == "condition":
        return bool
    return GOOD.get(parameter.annotation, "x" if "str" in str(parameter.annotation) else dashboard.PLAY)


def bad(parameter: inspect.Parameter) -> Iterator[Any]:
    quantity = QUANTITIES.get(parameter.name)
    optional = "None" in str(parameter.annotation)
    if quantity is None and parameter.annotation not in (int, float):
        yield from (value for value in (5.5, object(), None) if not (optional and value is None))
        return
    no_double = parameter.annotation is not float or quantity is not None
    yield from (value for value in NOT_NUMBERS if not (optional and value is None) and (no_double or value != 1e300))
    if quantity is None or not quantity.size:
        yield [1.0]
        yield -math.inf
        return
    fitting = good(parameter)
    yield from ([], fitting[1:], [*fitting, *fitting[:1]])
    for wrong in NOT_NUMBERS:
        yield [*fitting[1:], wrong]
        yield [wrong, *fitting[1:]]


def run(call: Callable[..., Any], args: list[Any], kwargs: dict[str, Any]) -> None:
    result = call(*args, **kwargs)
    if inspect.iscoroutine(result):
        asyncio.run(result)


@pytest.mark.parametrize(("get", "signature", "parameter"), CHECKED)
def test_bad_values_are_refused_before_anything_is_sent(get, signature, parameter):
    call, others = get(), [one for one in signature.parameters.values() if one.name not in ("self", parameter.name)]
    named = {one.name: good(one) for one in others if one.kind is one.KEYWORD_ONLY and one.default is one.empty}
    for value in bad(parameter):
        args = []
        for one in signature.parameters.values():
            if one is parameter and one.kind is not one.KEYWORD_ONLY:
                args.append(value)
                break
            if one.name != "self" and one.kind in (one.POSITIONAL_ONLY, one.POSITIONAL_OR_KEYWORD):
                args.append(good(one) if one.default is one.empty else one.default)
        keyword = {parameter.name: value} if parameter.kind is parameter.KEYWORD_ONLY else {}
        with pytest.raises(LocalProtocolError) as refusal:
            run(call, args, keyword | named)
        assert str(refusal.value).endswith(f"not {quoted(value)}")  # and not another argument


@pytest.mark.parametrize("moves", [5, None, ["abc"], [None], "abc", [points.movej([0.0] * 6), math.nan]])
@pytest.mark.parametrize("call", [AsyncRobot(HOST).sequence, URDriver(HOST).execute, URDriver(HOST).stream])
def test_a_trajectory_of_something_else_is_refused(call, moves):
    with pytest.raises(LocalProtocolError):
        asyncio.run(call(moves))


@pytest.mark.parametrize("call", ["servoj", "servo_pose", "speedj", "speedl"])
def test_a_timeout_that_the_robot_does_not_keep_is_refused(call):
    with pytest.raises(LocalProtocolError, match=r"waits at most 0\.2 s for the next setpoint, not 0\.5"):
        getattr(URDriver(HOST), call)([0.0] * 6, 0.5)


@pytest.mark.parametrize("frame", [5, None, "world", [0.0] * 5, [math.nan] * 6])
def test_a_frame_that_is_none_is_refused(frame):
    with pytest.raises(LocalProtocolError):
        asyncio.run(AsyncRobot(HOST).jog([0.0] * 6, frame=frame))


@pytest.mark.parametrize("name", [one.name for one in fields(DriverConfig) if one.name in QUANTITIES])
def test_options_are_checked_as_well(name):
    for value in ("abc", math.nan, -1.0, [1.0]):
        with pytest.raises(LocalProtocolError):
            AsyncRobot(HOST, **{name: value})


def test_values_of_numpy_are_accepted():
    numpy = pytest.importorskip("numpy")
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
