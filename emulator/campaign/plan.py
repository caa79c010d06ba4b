"""The runs of a campaign: the product of its axes. Each run is a command line that can be typed in a shell.

    script: pick.script               # or  pytest: tests/test_pick.py;  one, or a list of them
    limit_s: 120                      # of robot time for a script, of real time for a pytest
    options: {arm: dynamic}           # of every run
    matrix:
      robot: [{model: ur3, polyscope: 3.15.8}, {model: ur5e}]
      fault: [null, "encoder_jump,joint=1,by_rad=0.3,after=2"]
      seed: {from: 0, count: 1000}

An axis is an option with its values, or any name with values that are mappings of options. Options are those of
``urscript run``; for pytest, those of a robot, which the plugin applies unless a test sets them itself.
"""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from shlex import join
from typing import Annotated, Any, Final, TypeAlias

import msgspec

from emulator.config import ConfigError, read_yaml
from emulator.script_options import parsed
from emulator.script_run import check
from urproto.compat import StrEnum
from urproto.structures import converted

Options: TypeAlias = dict[str, Any]
_LIMIT_S: Final = 600.0  # guess: a program that takes longer is waiting for something
_MAX_RUNS: Final = 1_000_000_000  # so that numbers of runs fit into the results
_NOT_IN_CAMPAIGNS: Final = {
    "speed": "runs are in virtual time; for the speed slider use speed-slider",
    "trace": "add it to the replay command of a run instead",
    "timeout": "use limit_s instead",
}


class Kind(StrEnum):
    """What a run executes."""

    SCRIPT = "script"
    PYTEST = "pytest"


class Numbers(msgspec.Struct, frozen=True, forbid_unknown_fields=True, rename={"first": "from"}):
    """Integers as the values of an axis."""

    count: Annotated[int, msgspec.Meta(ge=1)]
    first: int = 0


class _File(msgspec.Struct, forbid_unknown_fields=True):
    script: str | list[str] | None = None
    pytest: str | list[str] | None = None
    limit_s: Annotated[float, msgspec.Meta(gt=0.0)] = _LIMIT_S
    options: dict[str, Any] = {}
    matrix: dict[str, Any] = {}


class Axis(msgspec.Struct, frozen=True):
    """A name and its values."""

    name: str
    values: Numbers | list[Any]

    def __len__(self) -> int:
        return self.values.count if isinstance(self.values, Numbers) else len(self.values)

    def value(self, index: int) -> Any:
        return self.values.first + index if isinstance(self.values, Numbers) else self.values[index]


@dataclass(frozen=True)
class Run:
    """A run: its script or test, and its options. number: number within the campaign, from 0."""

    number: int
    target: str
    options: Mapping[str, Any]


class Plan(msgspec.Struct, frozen=True):
    """All runs of a campaign. The last axis varies fastest. folder: the folder to which paths are relative."""

    name: str
    folder: str
    kind: Kind
    limit_s: float
    options: Options
    axes: list[Axis]

    def __len__(self) -> int:
        return prod(len(axis) for axis in self.axes)

    def run(self, number: int) -> Run:
        return self.run_at(number, self.place(number))

    def place(self, number: int) -> tuple[int, ...]:
        """The index of a run's value on each axis."""
        indexes = []
        for axis in reversed(self.axes):
            number, index = divmod(number, len(axis))
            indexes.append(index)
        return tuple(reversed(indexes))

    def run_at(self, number: int, place: Sequence[int]) -> Run:
        options = dict(self.options)
        target = ""
        for axis, index in zip(self.axes, place, strict=True):
            value = axis.value(index)
            if axis.name == self.kind:
                target = value
            elif isinstance(value, Mapping):
                options |= value
            else:
                options[axis.name] = value
        return Run(number, target, {name: value for name, value in options.items() if value is not None})

    def command(self, run: Run) -> list[str]:
        """The command that repeats this run, in the campaign's folder."""
        words = _pytest_words(run.options) if self.kind is Kind.PYTEST else _script_words(run.options)
        if self.kind is Kind.PYTEST:
            return ["pytest", run.target, *words]
        return ["urscript", "run", run.target, *words, "--timeout", f"{self.limit_s:g}"]

    @property
    def fingerprint(self) -> str:
        """A hash of the plan and the files that it names, which changes if the runs would. Raises ConfigError."""
        digest = hashlib.sha256(msgspec.json.encode([self.name, self.kind, self.limit_s, self.options, self.axes]))
        for text in sorted(_texts([self.options, *(axis.values for axis in self.axes)])):
            file = Path(self.folder, text.partition("::")[0])
            if file.is_file():
                digest.update(file.read_bytes())
        return digest.hexdigest()


def read_plan(path: Path) -> Plan:
    """Read a campaign file. Raises ConfigError, also for an invalid option of any axis."""
    file = converted(read_yaml(path), _File, path, ConfigError)
    if (file.script is None) == (file.pytest is None):
        raise ConfigError(f"{path}: give either 'script' or 'pytest'")
    kind = Kind.PYTEST if file.script is None else Kind.SCRIPT
    targets = file.script if file.pytest is None else file.pytest
    axes = [Axis(kind, targets if isinstance(targets, list) else [targets])]
    axes += [Axis(name, _values(path, name, values)) for name, values in file.matrix.items()]
    if empty := [axis.name for axis in axes if not len(axis)]:
        raise ConfigError(f"{path}: {empty[0]} has no values: nothing would run")
    plan = Plan(path.stem, str(path.parent.resolve()), kind, file.limit_s, file.options, axes)
    if len(plan) > _MAX_RUNS:
        raise ConfigError(f"{path} has {len(plan):,} runs: the maximum is {_MAX_RUNS:,}")
    _check_names(path, plan)
    _check_values(path, plan)
    return plan


def _values(path: Path, name: str, values: Any) -> Numbers | list[Any]:
    if isinstance(values, list):
        return values
    where = f"{path}: {name}: write a list of values, or {{from: 0, count: 100}} for numbers"
    return converted(values, Numbers, where, ConfigError)


def _check_names(path: Path, plan: Plan) -> None:
    """Check that no option comes from two sources, and none is reserved for campaigns."""
    seen: dict[str, str] = {}
    sources = [("options", [plan.options])]
    sources += [(axis.name, axis.values) for axis in plan.axes if isinstance(axis.values, list)]
    sources += [(axis.name, []) for axis in plan.axes if not isinstance(axis.values, list)]
    for source, values in sources:
        mappings = [value for value in values if isinstance(value, Mapping)]
        if mappings and len(mappings) < len(values):
            raise ConfigError(f"{path}: {source}: either all of its values must be mappings of options, or none")
        for name in (
            {str(name) for value in mappings for name in value} if mappings or source == "options" else {source}
        ):
            if plan.kind is Kind.SCRIPT and name in _NOT_IN_CAMPAIGNS:
                raise ConfigError(f"{path}: {name} is not an option of a campaign: {_NOT_IN_CAMPAIGNS[name]}")
            if name in seen:
                raise ConfigError(f"{path}: {name} is in {seen[name]} and in {source}: leave out one of them")
            seen[name] = source
        for value in values:
            polyscope = value.get("polyscope") if isinstance(value, Mapping) else value if source == "polyscope" else ""
            if isinstance(polyscope, int | float):
                raise ConfigError(f"{path}: polyscope: {polyscope}: write it in quotes, because YAML reads 5.10 as 5.1")


def _check_values(path: Path, plan: Plan) -> None:
    """Check every value of every axis, together with the first values of the others."""
    if plan.kind is Kind.PYTEST:
        for target in plan.axes[0].values if isinstance(plan.axes[0].values, list) else ():
            if not Path(plan.folder, target.partition("::")[0]).exists():
                raise ConfigError(f"{path}: {target} is not there")
        return
    usual = [0] * len(plan.axes)
    _check_script(path, plan, plan.run_at(0, usual))
    for number, axis in enumerate(plan.axes):
        for index in range(1, 0 if isinstance(axis.values, Numbers) else len(axis)):
            place = [*usual[:number], index, *usual[number + 1 :]]
            _check_script(path, plan, plan.run_at(0, place))


def _check_script(path: Path, plan: Plan, run: Run) -> None:
    try:
        options = parsed(plan.command(run)[2:])
        for name in ("file", "world", "peers", "arm"):
            value = getattr(options, name)
            if value is not None and (name != "arm" or Path(plan.folder, value).is_file()):
                setattr(options, name, type(value)(Path(plan.folder, value)))
        check(options)
    except ValueError as error:
        raise ConfigError(f"{path}: {error} ({join(plan.command(run))})") from error


def _script_words(options: Mapping[str, Any]) -> list[str]:
    words: list[str] = []
    for name, value in options.items():
        option = "--" + name.replace("_", "-")
        if option == "--joints" and isinstance(value, list):
            words += [option, *(str(angle) for angle in value)]
        else:
            words += [word for item in _items(value) for word in (option, str(item))]
    return words


def _pytest_words(options: Mapping[str, Any]) -> list[str]:
    words: list[str] = []
    for name, value in options.items():
        if name in ("model", "polyscope"):
            words += [f"--ur-{name}", str(value)]
        else:
            words += [word for item in _items(value) for word in ("--ur-option", f"{name}={item}")]
    return words


def _items(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _texts(value: Any) -> set[str]:
    if isinstance(value, str):
        return {value}
    if isinstance(value, Mapping):
        return {text for one in value.values() for text in _texts(one)}
    return {text for one in value for text in _texts(one)} if isinstance(value, list) else set()
