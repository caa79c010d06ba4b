"""Plays episodes of a task with a policy, and measures what the arm does in each control period.

A policy is a callable: the action for an observation. If it has ``reset(seed)``, that is called before each episode;
it may then draw random numbers, and have a memory. The seed of an episode determines it completely, wherever it is
played.
"""

import importlib
import importlib.util
import io
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from math import dist, hypot, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from emulator.learning import GoalEnv, RobotEnv, TaskError
from emulator.physics.cameras import CameraError
from urproto.durable import write_file
from urproto.vectors import sub

if TYPE_CHECKING:
    from emulator.snapshot import Snapshot

RANDOM: Final = "random"
LATENCY: Final = "latency_s"
Policy = Callable[[Any], Any]
_QUALITY: Final = 60
_CAMERA: Final = "overview"


@dataclass(frozen=True)
class Setting:
    """What is evaluated. task: of `GoalEnv`, or ``FILE.py:CLASS``. policy: ``FILE.py:NAME``, called with the
    environment, or ``random``. options: of the environment. latency: where that of its options is from. steps: of an
    episode; 0 stands for those of the task."""

    task: str
    policy: str
    options: tuple[tuple[str, Any], ...] = ()
    latency: str = ""
    steps: int = 0

    def environment(self, **options: Any) -> RobotEnv[Any, Any]:
        """A new environment. Raises EvaluationError."""
        chosen = dict(self.options) | options
        try:
            if ":" in self.task:
                return called(f"the task {self.task}", load_named(self.task), **chosen)  # type: ignore[no-any-return]
            return GoalEnv(self.task, continuing_task=False, **chosen)
        except (TaskError, TypeError, ValueError, OSError) as error:
            raise EvaluationError(str(error)) from error

    def length(self, env: RobotEnv[Any, Any]) -> int:
        """Steps of an episode at most. Raises EvaluationError if nobody says how many."""
        if self.steps:
            return self.steps
        if isinstance(env, GoalEnv):
            return env.task.steps
        raise EvaluationError(f"{self.task} does not say how many steps an episode has: use --steps")


@dataclass(frozen=True)
class Episode:
    """What happened in an episode.

    duration_s: robot time. reward: sum. path_m: of the TCP. jerk_rad_s3: root mean square of the joints' jerk, from
    the accelerations of the target in two control periods. force_N: the largest at the TCP. late: steps in which the
    policy took longer than a step. stopped: why the robot or the task ended it, "" otherwise.
    """

    seed: int
    success: bool
    steps: int
    duration_s: float
    reward: float
    path_m: float
    jerk_rad_s3: float
    force_N: float
    late: int
    stopped: str


@dataclass
class _Meter:
    """Measures the arm in each control period, from its state at the end of the one before."""

    period_s: float
    path_m: float = 0.0
    force_N: float = 0.0
    _squares: float = 0.0
    _periods: int = 0
    _place: Sequence[float] = field(default_factory=tuple)
    _qdd: Sequence[float] = field(default_factory=tuple)

    def take(self, state: "Snapshot") -> None:
        place, qdd = state.actual_TCP_pose[:3], state.target_qdd
        if self._qdd:
            self.path_m += dist(place, self._place)
            self._squares += sum(step * step for step in sub(qdd, self._qdd)) / self.period_s**2
            self._periods += 1
        self._place, self._qdd = place, qdd
        self.force_N = max(self.force_N, hypot(*state.actual_TCP_force[:3]))

    @property
    def jerk_rad_s3(self) -> float:
        return sqrt(self._squares / self._periods) if self._periods else 0.0


class _RandomPolicy:
    """Any action."""

    def __init__(self, env: RobotEnv[Any, Any]) -> None:
        self._actions = env.action_space

    def reset(self, seed: int) -> None:
        self._actions.seed(seed)

    def __call__(self, seen: Any) -> Any:
        return self._actions.sample()


def play(setting: Setting, seed: int) -> Episode:
    """Play an episode, in the environment of the one before with this setting. Raises EvaluationError."""
    env, policy = _prepared(setting)
    return play_one(env, policy, setting.length(env), seed)


def play_one(
    env: RobotEnv[Any, Any],
    policy: Policy,
    steps: int,
    seed: int,
    on_step: Callable[[], None] = lambda: None,
) -> Episode:
    """Play one episode. on_step: called at its beginning, and after each step. Raises EvaluationError."""
    if hasattr(policy, "reset"):
        called("the policy's reset(seed)", policy.reset, seed)
    seen, _ = env.reset(seed=seed)
    meter = _Meter(env.robot.controller.period_s)
    began_s, reward, late, done, ended, info = env.state.timestamp, 0.0, 0, 0, False, {}
    on_step()
    with _measured(env, meter):
        while done < steps and not ended:
            action = called(f"the policy, in step {done} of episode {seed},", policy, seen)
            seen, gained, ended, _, info = called(f"step {done} of episode {seed}", env.step, action)
            reward, done, late = reward + gained, done + 1, late + bool(info.get("late"))
            on_step()
    state = env.state
    meter.take(state)
    return Episode(
        seed,
        bool(info.get("is_success")),
        done,
        round(state.timestamp - began_s, 6),
        reward,
        meter.path_m,
        meter.jerk_rad_s3,
        meter.force_N,
        late,
        str(info.get("stopped", "")),
    )


def policy_of(setting: Setting, env: RobotEnv[Any, Any]) -> Policy:
    """A new policy. Raises EvaluationError."""
    if setting.policy == RANDOM:
        return _RandomPolicy(env)
    policy = called(f"the policy {setting.policy}", load_named(setting.policy), env)
    if not callable(policy):
        raise EvaluationError(
            f"{setting.policy} returned {type(policy).__name__}, which cannot be called with an observation"
        )
    found: Policy = policy
    return found


@lru_cache(maxsize=1)
def _prepared(setting: Setting) -> tuple[RobotEnv[Any, Any], Policy]:
    env = setting.environment()
    return env, policy_of(setting, env)


@contextmanager
def _measured(env: RobotEnv[Any, Any], meter: _Meter) -> Iterator[None]:
    controller = env.robot.controller

    def take() -> None:
        meter.take(controller.snapshot)

    controller.on_tick.append(take)
    try:
        yield
    finally:
        controller.on_tick.remove(take)


class EvaluationError(ValueError):
    """The evaluation cannot be carried out, for a reason that is the user's to change."""


def load_named(place: str) -> Any:
    """What a file or module calls so: ``policies.py:Reach``, ``package.module:Reach``. Raises EvaluationError."""
    source, _, name = place.rpartition(":")
    if not source or not name:
        raise EvaluationError(f"{place!r} must be FILE.py:NAME or MODULE:NAME")
    try:
        module = _module_of(Path(source)) if source.endswith(".py") else importlib.import_module(source)
    except Exception as error:  # a user's file may raise anything
        raise EvaluationError(f"{source} cannot be loaded: {_described(error)}") from error
    if not hasattr(module, name):
        raise EvaluationError(f"{source} has no {name}")
    return getattr(module, name)


def called(what: str, function: Any, *values: Any, **named: Any) -> Any:
    """Call what is a user's. Raises EvaluationError, which says where it failed."""
    try:
        return function(*values, **named)
    except Exception as error:
        raise EvaluationError(f"{what} failed: {_described(error)}") from error


def _module_of(path: Path) -> Any:
    name = path.stem
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    if str(path.parent.resolve()) not in sys.path:
        sys.path.insert(0, str(path.parent.resolve()))  # as for a script, which imports what is beside it
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _described(error: Exception) -> str:
    """An error in one line, with the place of its innermost frame."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    place = "" if frame is None else f" ({Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno})"
    text = " ".join(str(error).split())
    return f"{type(error).__name__}{place}: {text}" if text else f"{type(error).__name__}{place}"


def keep_failure(setting: Setting, episode: Episode, folder: Path) -> list[Path]:
    """Write ``SEED.journal`` and, if the scene has a camera ``overview`` and pictures can be rendered, ``SEED.webp``.

    Returns the files; none if the episode went otherwise this time. Raises EvaluationError.
    """
    env = setting.environment(recorded=True, checked=True)
    pictures: list[Any] = []
    try:
        policy = policy_of(setting, env)
        if play_one(env, policy, setting.length(env), episode.seed, lambda: _film(env, pictures)) != episode:
            return []
        files = {"journal": env.robot.journal}
        if pictures:
            files["webp"] = _webp(pictures, env.step_s)
    finally:
        env.close()
    folder.mkdir(exist_ok=True)
    paths = []
    for suffix, content in files.items():
        paths.append(folder / f"{episode.seed}.{suffix}")
        write_file(paths[-1], content)
    return paths


def _film(env: RobotEnv[Any, Any], pictures: list[Any]) -> None:
    if _CAMERA not in env.scene.cameras:
        return
    try:
        pictures.append(env.picture(_CAMERA))
    except CameraError:  # no renderer on this machine: the journal shows more anyway
        return


def _webp(pictures: Sequence[Any], step_s: float) -> bytes:
    from PIL import Image

    first, *others = (Image.fromarray(picture) for picture in pictures)
    film = io.BytesIO()
    first.save(
        film, "webp", save_all=True, append_images=others, duration=round(1000 * step_s), loop=0, quality=_QUALITY
    )
    return film.getvalue()
