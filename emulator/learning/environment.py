"""The base class of tasks: a robot in virtual time, its program, and a scene, in the same state for each episode.

The actions of a policy reach the robot as they would reach a real one: through input registers, which a permanently
running program reads. So the same program, with the same registers written through RTDE, lets a policy act on a real
arm.
"""

from abc import abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from emulator.control.snapshots import check_rest
from emulator.physics import open_cameras
from emulator.virtual import virtual_robot
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import RuntimeState, SafetyMode
from urproto.vectors import all_finite

if TYPE_CHECKING:
    from emulator.physics.cameras import Cameras
    from emulator.snapshot import Snapshot
    from emulator.virtual import VirtualRobot
    from emulator.world.world import World

Observation = TypeVar("Observation")
Action = TypeVar("Action")

FIRST_REGISTER: Final = 24
"""First double register for RTDE clients; 0 to 23 are for fieldbuses."""
FIRST_BIT: Final = 64
"""First bit register for RTDE clients."""
_SEEDS: Final = 2**32
_SETTLING_S: Final = 0.5  # in which objects come to rest before the first episode
_STOPPING_S: Final = 2.0  # for an arm to stand still after its program was stopped; then a new robot replaces it


class TaskError(Exception):
    """The task is invalid: its program does not start, or its robot cannot be put into the initial state."""


class RobotEnv(gymnasium.Env[Observation, Action]):
    """A robot and its scene. A step takes ``step_s`` of robot time, regardless of its real duration.

    A task defines `world` and `program`, sets ``observation_space`` and ``action_space`` in its constructor, and
    implements `arrange`, `act`, `observe` and `judge`. An episode ends when the robot stops for any reason, which
    ``info`` contains as ``stopped``.

    model: name of the arm. step_s: a multiple of the control period, which is 8 ms for a CB3 arm. camera: name of a
    camera of the scene, for ``rgb_array``. options: those of ``virtual_robot``, for example ``fault`` or
    ``arm="dynamic"``. Raises TaskError, and whatever ``virtual_robot`` raises.
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
            raise TaskError(f"render_mode must be rgb_array or None, not {render_mode!r}")
        self.render_mode = render_mode
        self._camera = camera
        self._cameras: Cameras | None = None
        self._options = {"world": self.world, "physics": True, "running": True, "recorded": False, **options}
        self._model = model
        self.robot: VirtualRobot = virtual_robot(model, **self._options)
        period_s = self.robot.controller.period_s
        self._periods = max(1, round(step_s / period_s))
        self.step_s: float = self._periods * period_s
        vars(self)["metadata"] = {**self.metadata, "render_fps": round(1.0 / self.step_s)}  # Gymnasium reads it there
        self._script = self.program.replace("{step_s}", f"{self.step_s:.6f}")
        self._prepare()

    # implemented by a task

    @abstractmethod
    def arrange(self, options: dict[str, Any]) -> None:
        """Vary the initial state of an episode, with ``np_random``. options: those of ``reset``."""

    @abstractmethod
    def act(self, action: Action) -> None:
        """Command the robot for one step, for example with `write` and `switch`."""

    @abstractmethod
    def observe(self) -> Observation:
        """The current observation."""

    @abstractmethod
    def judge(self) -> tuple[float, bool, dict[str, Any]]:
        """The reward of the last step, whether the episode is over, and further information."""

    # available to a task

    @property
    def state(self) -> "Snapshot":
        """The state of the controller, with the names of RTDE fields."""
        return self.robot.controller.snapshot

    @property
    def scene(self) -> "World":
        """The objects around the arm: ``pose()``, ``poses()``, ``move()``."""
        world = self.robot.controller.world
        assert world is not None
        return world

    @property
    def stopped(self) -> str:
        """Why the robot has stopped: the safety mode, or the end of the program; "" while it runs."""
        if self.state.safety_mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            return SafetyMode(self.state.safety_mode).name
        return "" if self.state.runtime_state == RuntimeState.PLAYING else "the program ended"

    def write(self, *values: float) -> None:
        """Write double input registers, from `FIRST_REGISTER` on. Raises ValueError for values that are not finite."""
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

    # the interface of Gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: robot and scene return to their initial state, which `arrange` varies."""
        super().reset(seed=seed)
        self._return()
        self.robot.controller.chances.restart(int(self.np_random.integers(_SEEDS)))
        self.arrange(options or {})
        self._begin()
        return self.observe(), {}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act, advance robot time by ``step_s``, and observe."""
        self.act(action)
        self.robot.step(self._periods)
        reward, terminated, info = self.judge()
        if self.stopped:
            terminated, info = True, info | {"stopped": self.stopped}
        return self.observe(), float(reward), terminated, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """The image of the camera (height, width, 3). Raises CameraError if rendering is not available."""
        if self.render_mode is None:
            return None
        if self._cameras is None:
            self._cameras = open_cameras(self.scene)
        return self._cameras.rgb(self._camera)

    def close(self) -> None:
        """Release graphics memory."""
        if self._cameras is not None:
            self._cameras.close()
            self._cameras = None

    # episodes

    def _prepare(self) -> None:
        """Save the initial state of episodes, after the program has run once, because that compiles it."""
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
        """Stop everything, so that the state can be saved; False if that takes too long."""
        controller = self.robot.controller
        controller.programs.stop("the episode ended")
        self.write(*[0.0] * 6)
        self.switch(False)
        if controller.safety.mode is SafetyMode.PROTECTIVE_STOP:
            self.robot.unlock_protective_stop()
        for _ in range(round(_STOPPING_S / controller.period_s)):
            self.robot.step(1)
            try:
                check_rest(controller)
                return True
            except NotPossible:
                continue
        return False

    def _wait(self, seconds: float) -> None:
        self.robot.step(round(seconds / self.robot.controller.period_s))
