"""What an exploration may choose: an action on the robot or on a peer, with values from ranges, at any time.

    part arrives: {verb: set_digital_input, index: 0, level: true, at: 0..10}
    operator pauses: {verb: dashboard, line: pause, then: {verb: dashboard, line: play, after: 0.1..3}}
    vision is late: {peer: "10.0.0.5:5000", late: 0.01..2}
    setpoint is late: {session: moved, by: 1..20}  # with a recorded session (`emulator.explore.session`)

A value may be a range of numbers, ``LOW..HIGH``, or a list of alternatives. To add a kind, add a class to ``KINDS``.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any, Final, Protocol, TypeAlias

from emulator.control.control import Control
from emulator.control.verbs import Verb, verbs_of
from emulator.explore.disturbances import PeerDisturbance, address_of
from urproto.structures import converted
from urproto.text import number, unknown

_RANGE: Final = re.compile(r"\s*(-?[0-9.]+(?:e-?[0-9]+)?)\s*\.\.\s*(-?[0-9.]+(?:e-?[0-9]+)?)\s*")
_WHOLE: Final = re.compile("-?[0-9]+")
_VERBS: Final = verbs_of(subject for subject in Control.SUBJECTS if subject.changes)
_SHORT: Final = {"fault": "inject_fault", "dashboard": "dashboard"}
_FEW: Final = 0.3  # of values are an end of their range

Values: TypeAlias = dict[str, Any]


class PlanError(ValueError):
    """The description of an exploration is invalid."""


class Sending(Protocol):
    """The messages of a session that are to be sent."""

    def change(self, change: str, number: int, by: int = 0) -> None: ...


class Target(Protocol):
    """What choices act on."""

    @property
    def robot(self) -> Control: ...

    @property
    def peers(self) -> PeerDisturbance: ...

    @property
    def sending(self) -> Sending: ...


class Domain(Protocol):
    """The values that a parameter may have."""

    def draw(self, chance: Random) -> Any: ...

    def simpler(self, value: Any) -> Iterator[Any]:
        """Simpler values than this one, the simplest first."""


@dataclass(frozen=True)
class Fixed:
    """A parameter that is not chosen."""

    value: Any

    def draw(self, chance: Random) -> Any:
        return self.value

    def simpler(self, value: Any) -> Iterator[Any]:
        return iter(())


@dataclass(frozen=True)
class OneOf:
    """Alternatives, of which earlier ones are simpler."""

    values: Sequence[Any]

    def draw(self, chance: Random) -> Any:
        return chance.choice(self.values)

    def simpler(self, value: Any) -> Iterator[Any]:
        return iter(self.values[: self.values.index(value)])


@dataclass(frozen=True)
class Span:
    """Numbers from a range, as often small ones as large ones; integers if both ends are."""

    low: float
    high: float
    whole: bool

    def draw(self, chance: Random) -> Any:
        if chance.random() < _FEW:
            return self._as_given(chance.choice((self.low, self.high)))
        if self.low > 0.0 and self.high / self.low > 10.0:
            return self._as_given(math.exp(chance.uniform(math.log(self.low), math.log(self.high))))
        return self._as_given(chance.uniform(self.low, self.high))

    def simpler(self, value: Any) -> Iterator[Any]:
        if value in (self.low, self.high):
            return
        for candidate in (self.low, self.high, round(value), round(value, 1), round(value, 2)):
            if self.low <= candidate <= self.high and len(str(candidate)) < len(str(value)):
                yield self._as_given(candidate)

    def _as_given(self, value: float) -> Any:
        return round(value) if self.whole else value


def domain_of(value: Any) -> Domain:
    """The domain that a value of the plan describes. Raises PlanError."""
    if isinstance(value, list):
        if not value:
            raise PlanError("an empty list leaves nothing to choose")
        return OneOf([tuple(one) if isinstance(one, list) else one for one in value])  # schedules are hashed
    match = _RANGE.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        return Fixed(value)
    try:
        low, high = number(match[1]), number(match[2])
    except ValueError as error:
        raise PlanError(f"{value!r} is not a range: {error}") from error
    if low > high:
        raise PlanError(f"{value!r}: a range is LOW..HIGH")
    return Span(low, high, bool(_WHOLE.fullmatch(match[1]) and _WHOLE.fullmatch(match[2])))


class Kind(ABC):
    """What a choice does. parameters: with the values they may have."""

    parameters: dict[str, Domain]

    @abstractmethod
    def apply(self, target: Target, values: Values, period: int) -> None:
        """Do it. period: for which it was decided."""

    @abstractmethod
    def words(self, values: Values, period: int) -> str:
        """What it does, as part of a sentence."""

    def limited(self, at: Span) -> Span:
        """When it can be decided, if it is to happen in a range of times [s]. Raises PlanError."""
        return at

    def settled(self, period: int) -> int:
        """The control period in which it happens if it is decided for that one."""
        return period


class CallVerb(Kind):
    """Calls a verb of the control API. At a moment when the robot refuses it, nothing happens."""

    def __init__(self, entry: Mapping[str, Any]) -> None:
        (key,) = [key for key in ("verb", *_SHORT) if key in entry]
        given = {name: value for name, value in entry.items() if name != key}
        if key == "fault":
            given["kind"] = entry[key]
        elif key == "dashboard":
            given["line"] = entry[key]
        name = entry["verb"] if key == "verb" else _SHORT[key]
        if name not in _VERBS:
            raise PlanError(unknown("verb", str(name), _VERBS))
        self.name = name
        self._verb: Verb = _VERBS[name]
        self.parameters = {parameter: domain_of(value) for parameter, value in given.items()}
        self._check()

    def _check(self) -> None:
        """Raises PlanError for wrong names and for values of wrong types."""
        example = {name: domain.draw(Random(0)) for name, domain in self.parameters.items()}
        converted(example, self._verb.parameters, self._verb.name, PlanError)

    def apply(self, target: Target, values: Values, period: int) -> None:
        self._verb.call(target.robot, values)

    def words(self, values: Values, period: int) -> str:
        return f"{self._verb.name}({', '.join(f'{name}={_shown(value)}' for name, value in values.items())})"


class DisturbPeer(Kind):
    """What a peer sends arrives ``late`` [s], ``garbled``, or not at all (``silent``); for ``lasting`` [s]."""

    _PARAMETERS: Final = ("late", "garbled", "silent", "lasting")

    def __init__(self, entry: Mapping[str, Any]) -> None:
        given = dict(entry)
        try:
            self._address = address_of(str(given.pop("peer")))
        except ValueError as error:
            raise PlanError(str(error)) from error
        if wrong := sorted(set(given) - set(self._PARAMETERS)):
            raise PlanError(f"peer: {unknown('word', wrong[0], self._PARAMETERS)}")
        if not set(given) & {"late", "garbled", "silent"}:
            raise PlanError("peer: say whether it is late, garbled or silent")
        self.parameters = {name: domain_of(value) for name, value in given.items()}

    def apply(self, target: Target, values: Values, period: int) -> None:
        target.peers.begin(self._address, **values)

    def words(self, values: Values, period: int) -> str:
        what = [f"{_shown(values['late'])} s late"] if values.get("late") else []
        what += [word for word in ("garbled", "silent") if values.get(word)]
        lasting = f" for {_shown(values['lasting'])} s" if "lasting" in values else ""
        host, port = self._address
        return f"{host}:{port} is {' and '.join(what) or 'as usual'}{lasting}"


Kinds: TypeAlias = Mapping[str, Callable[[Mapping[str, Any]], Kind]]
"""Kinds of choices by the key that an entry of the plan has for them."""

KINDS: Final[Kinds] = {"verb": CallVerb, "fault": CallVerb, "dashboard": CallVerb, "peer": DisturbPeer}


def _kind_of(entry: Mapping[str, Any], kinds: Kinds) -> Kind:
    """The kind of choice that an entry of the plan describes. Raises PlanError."""
    for key, kind in kinds.items():
        if key in entry:
            return kind(entry)
    raise PlanError(f"a choice has one of the keys {', '.join(kinds)}, not {', '.join(map(str, entry))}")


@dataclass(frozen=True)
class Choice:
    """A thing that may happen. at: when [s]. then: what follows it, and how long after [s]."""

    name: str
    kind: Kind
    at: Span
    then: Kind | None = None
    after: Domain = Fixed(0.0)

    @property
    def parameters(self) -> dict[str, Domain]:
        """All that is chosen, other than when."""
        following = {"then": self.after, **self.then.parameters} if self.then is not None else {}
        return self.kind.parameters | {f"{name} after": domain for name, domain in following.items()}

    def draw(self, chance: Random) -> Values:
        return {name: domain.draw(chance) for name, domain in self.parameters.items()}

    def actions(self, values: Values) -> Iterator[tuple[float, Kind, Values]]:
        """What happens: delay [s], kind, and its values."""
        yield 0.0, self.kind, {name: values[name] for name in self.kind.parameters}
        if self.then is not None:
            yield values["then after"], self.then, {name: values[f"{name} after"] for name in self.then.parameters}


@dataclass(frozen=True, order=True)
class Decision:
    """A choice that was made: in which control period of the run, and its values as pairs."""

    period: int
    choice: str
    values: tuple[tuple[str, Any], ...] = ()


Schedule: TypeAlias = tuple[Decision, ...]
"""Decisions in the order of their periods."""


def parse_choice(name: str, entry: Any, lasts_s: float, kinds: Kinds = KINDS) -> Choice:
    """The choice that an entry of the plan describes. Raises PlanError."""
    try:
        if not isinstance(entry, Mapping):
            raise PlanError("write what happens, for example {verb: protective_stop}")
        given = dict(entry)
        at = domain_of(given.pop("at", f"0..{lasts_s:g}"))
        if isinstance(at, Fixed):
            at = Span(float(at.value), float(at.value), whole=False)
        if not isinstance(at, Span) or not 0.0 <= at.low <= at.high <= lasts_s:
            raise PlanError(f"at is a time or a range of times from 0 to {lasts_s:g} s")
        following = given.pop("then", None)
        kind = _kind_of(given, kinds)
        at = kind.limited(at)
        if following is None:
            return Choice(name, kind, at)
        after = domain_of(following.get("after", 0.0))
        then = _kind_of({key: value for key, value in following.items() if key != "after"}, kinds)
        return Choice(name, kind, at, then, after)
    except (PlanError, TypeError, AttributeError) as error:
        raise PlanError(f"{name}: {error}") from error


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else repr(value) if isinstance(value, str) else str(value)
