"""The base of tasks: one robot in virtual time, its program, and a scene that begins each episode alike.

What a policy decides reaches the robot as it would a real one: by input registers, which a program that runs all the
time reads. So the same program and the same registers, written by RTDE, make a policy act on an arm of metal.
"""

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from emulator.control.verbs import BadArguments, NotPossible
from emulator.physics import open_cameras
from urproto.modes import RuntimeState, SafetyMode
from urproto.testing.virtual import virtual_robot
from urproto.vectors import all_finite

if TYPE_CHECKING:
    from emulator.control.control import VirtualRobot
    from emulator.physics.cameras import Cameras
    from emulator.snapshot import Snapshot
    from emulator.world.world import World

Observation = TypeVar("Observation")
Action = TypeVar("Action")

FIRST_REGISTER: Final = 24
"""Of the double registers that RTDE clients write; 0 to 23 are for fieldbuses."""
FIRST_BIT: Final = 64
"""Of the bit registers that RTDE clients write."""
_SETTLING_S: Final = 0.5  # in which things come to rest on each other before the first episode
_STOPPING_S: Final = 2.0  # in which an arm stands after its program was stopped; else a new robot takes its place


class TaskError(Exception):
    """A task that cannot be: its program does not start, or its robot cannot be put to its beginning."""


class RobotEnv(gymnasium.Env[Observation, Action]):
    """A robot and its scene. A step is ``step_s`` of the robot's time, however long it takes.

    A task gives `world` and `program`, sets ``observation_space`` and ``action_space`` in its constructor, and says
    what `arrange`, `act`, `observe` and `judge` do. An episode ends when the robot stops, whatever stopped it: ``info``
    has the reason as ``stopped``.

    model: an arm; step_s: in whole control periods, 8 ms with a CB3 arm. camera: of the scene, for ``rgb_array``.
    options: as of ``virtual_robot``, say ``fault`` or ``arm="dynamic"``. Raises TaskError, and what ``virtual_robot``
    raises.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 25}  # type: ignore[misc]
    world: ClassVar[Path]
    """The scene: a world file, MJCF or URDF."""
    program: ClassVar[str]
    """URScript that runs during an episode. ``{step_s}`` in it becomes the length of a step [s]."""

    def __init__(
        self,
        *,
        render_mode: str | None = None,
        model: str = "ur5",
        step_s: float = 0.04,
        camera: str = "overview",
        **options: Any,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise TaskError(f"render_mode is rgb_array or None, not {render_mode!r}")
        self.render_mode = render_mode
        self._camera = camera
        self._cameras: Cameras | None = None
        self._options = {"world": self.world, "physics": True, "running": True, **options}
        self._model = model
        self.robot: VirtualRobot = virtual_robot(model, **self._options)
        period_s = self.robot.controller.period_s
        self._periods = max(1, round(step_s / period_s))
        self.step_s: float = self._periods * period_s
        vars(self)["metadata"] = {**self.metadata, "render_fps": round(1.0 / self.step_s)}  # Gymnasium reads it there
        self._script = self.program.replace("{step_s}", f"{self.step_s:.6f}")
        self._prepare()

    # what a task says

    @abstractmethod
    def arrange(self, options: dict[str, Any]) -> None:
        """Make an episode's beginning differ from others, with ``np_random``; options: those of ``reset``."""

    @abstractmethod
    def act(self, action: Action) -> None:
        """Let the robot do something for one step, as with `write` and `switch`."""

    @abstractmethod
    def observe(self) -> Observation:
        """What is seen now."""

    @abstractmethod
    def judge(self) -> tuple[float, bool, dict[str, Any]]:
        """The reward of the last step, whether the episode is over, and what else there is to know."""

    # what a task has for that

    @property
    def state(self) -> "Snapshot":
        """What the controller says of itself, with the names of RTDE's fields."""
        return self.robot.controller.snapshot

    @property
    def scene(self) -> "World":
        """What stands around the arm: ``pose()``, ``poses()``, ``move()``."""
        world = self.robot.controller.world
        assert world is not None
        return world

    @property
    def stopped(self) -> str:
        """Why the robot does not go on: the safety mode or the program's end; "" while it does."""
        if self.state.safety_mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            return SafetyMode(self.state.safety_mode).name
        return "" if self.state.runtime_state == RuntimeState.PLAYING else "the program ended"

    def write(self, *values: float) -> None:
        """Write double input registers, from `FIRST_REGISTER` on. Raises ValueError for what is not a number."""
        if not all_finite(values):
            raise ValueError(f"an action must be finite numbers, not {list(values)}")
        registers = self.robot.controller.registers.input
        for i, value in enumerate(values):
            registers.set_double(FIRST_REGISTER + i, float(value))

    def switch(self, *levels: bool) -> None:
        """Write bit input registers, from `FIRST_BIT` on."""
        registers = self.robot.controller.registers.input
        for i, level in enumerate(levels):
            registers.set_bit(FIRST_BIT + i, bool(level))

    # what Gymnasium asks

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: robot and scene are as they were at first, but for what `arrange` does."""
        super().reset(seed=seed)
        self._return()
        self.arrange(options or {})
        self._begin()
        return self.observe(), {}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act, let ``step_s`` of the robot's time go by, and look."""
        self.act(action)
        self.robot.step(self._periods)
        reward, terminated, info = self.judge()
        if self.stopped:
            terminated, info = True, info | {"stopped": self.stopped}
        return self.observe(), float(reward), terminated, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """The picture of the camera (height, width, 3). Raises CameraError where nothing draws."""
        if self.render_mode is None:
            return None
        if self._cameras is None:
            self._cameras = open_cameras(self.scene)
        return self._cameras.rgb(self._camera)

    def close(self) -> None:
        """Give the graphics memory back."""
        if self._cameras is not None:
            self._cameras.close()
            self._cameras = None

    # episodes

    def _prepare(self) -> None:
        """Keep what every episode begins with. The program has run once by then: it is compiled the first time only."""
        self._wait(_SETTLING_S)
        self._begin()
        if not self._rest():
            raise TaskError(f"{type(self).__name__}: the arm does not stand still after its program was stopped")
        try:
            self._beginning = self.robot.save()
        except NotPossible as error:
            raise TaskError(f"{type(self).__name__}: {error}") from error

    def _begin(self) -> None:
        if not self.robot.send_script(self._script):
            raise TaskError(f"{type(self).__name__}: its program does not start: {' '.join(self.robot.log(3))}")
        self.robot.step(1)

    def _return(self) -> None:
        if not self._rest():
            self.close()
            self.robot = virtual_robot(self._model, **self._options)
            self._prepare()
        try:
            self.robot.restore(self._beginning)
        except (NotPossible, BadArguments) as error:
            raise TaskError(f"{type(self).__name__}: {error}") from error

    def _rest(self) -> bool:
        """Stop everything, so that the state can be taken; False when that takes too long."""
        controller = self.robot.controller
        controller.programs.stop("the episode ended")
        self.write(*[0.0] * 6)
        self.switch(False)
        if controller.safety.mode is SafetyMode.PROTECTIVE_STOP:
            self.robot.unlock_protective_stop()
        for _ in range(round(_STOPPING_S / controller.period_s)):
            self.robot.step(1)
            try:
                self.robot.save()
                return True
            except NotPossible:
                continue
        return False

    def _wait(self, seconds: float) -> None:
        self.robot.step(round(seconds / self.robot.controller.period_s))
