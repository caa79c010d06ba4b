"""The base class of tasks: a robot in virtual time, its program, and a scene, in the same state for each episode.

The actions of a policy reach the robot as they would reach a real one: through input registers, which a permanently
running program reads. So the same program, with the same registers written through RTDE, lets a policy act on a real
arm.
"""

from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

import gymnasium
import numpy as np
from numpy.typing import NDArray

from emulator.control.snapshots import check_rest
from emulator.learning.task_file import TaskError
from emulator.physics import open_cameras
from emulator.virtual import virtual_robot
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import RuntimeState, SafetyMode
from urproto.vectors import Vector6, all_finite

if TYPE_CHECKING:
    from emulator.physics.cameras import Cameras
    from emulator.physics.world import PhysicsWorld
    from emulator.snapshot import Snapshot
    from emulator.virtual import VirtualRobot

Observation = TypeVar("Observation")
Action = TypeVar("Action")

FIRST_REGISTER: Final = 24
"""First double register for RTDE clients; 0 to 23 are for fieldbuses."""
FIRST_BIT: Final = 64
"""First bit register for RTDE clients."""
_SEEDS: Final = 2**32
_SETTLING_S: Final = 0.5  # in which objects come to rest before the first episode
_STOPPING_S: Final = 2.0  # for an arm to stand still after its program was stopped; then a new robot replaces it
_LONGEST_STEP_S: Final = 10.0


class RobotEnv(gymnasium.Env[Observation, Action]):
    """A robot and its scene. A step takes ``step_s`` of robot time, regardless of its real duration.

    A task defines `world` and `program`, sets ``observation_space`` and ``action_space`` in its constructor, and
    implements `arrange`, `act`, `observe` and `judge`. An episode ends when the robot stops for any reason, which
    ``info`` contains as ``stopped``.

    model: name of the arm. step_s: a multiple of the control period, which is 8 ms for a CB3 arm. latency_s: how long
    the policy computes: in each step the last action goes on for that time; a step takes longer than ``step_s`` if
    the policy does, and ``info`` then contains ``late``. Of several values, each step draws one. camera: name of a
    camera of the scene, for ``rgb_array``. recorded: whether the robot keeps a journal of what the environment does.
    options: those of ``virtual_robot``, for example ``fault`` or ``arm="dynamic"``. Raises TaskError, and whatever
    ``virtual_robot`` raises.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 25}  # type: ignore[misc]
    world: Path
    """The scene: a world file, MJCF or URDF."""
    program: str
    """URScript that runs during an episode. ``{step_s}`` in it becomes the time [s] after which it looks for the next
    action: the length of a step, or a control period if actions have a latency."""

    def __init__(
        self,
        *,
        render_mode: str | None = None,
        model: str = "ur5",
        step_s: float = 0.04,
        latency_s: float | Sequence[float] = 0.0,
        camera: str = "overview",
        recorded: bool = False,
        **options: Any,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise TaskError(f"render_mode must be rgb_array or None, not {render_mode!r}")
        self.render_mode = render_mode
        self._camera = camera
        self._cameras: Cameras | None = None
        latencies_s = [latency_s] if isinstance(latency_s, int | float) else list(latency_s)
        for name, times_s, least_s in (("step_s", [step_s], 0.001), ("latency_s", latencies_s, 0.0)):
            if not times_s or not all(least_s <= each_s <= _LONGEST_STEP_S for each_s in times_s):
                raise TaskError(f"{name} must be from {least_s:g} to {_LONGEST_STEP_S:g} s, not {times_s}")
        self._options = {"world": self.world, "physics": True, "running": True, "recorded": recorded, **options}
        self._model = model
        self.robot: VirtualRobot = virtual_robot(model, **self._options)
        period_s = self.robot.controller.period_s
        self._periods = max(1, round(step_s / period_s))
        self.step_s: float = self._periods * period_s
        self._latencies = [round(each_s / period_s) for each_s in latencies_s]  # in periods
        vars(self)["metadata"] = {**self.metadata, "render_fps": round(1.0 / self.step_s)}  # Gymnasium reads it there
        self._script = self.program.replace("{step_s}", f"{period_s if any(self._latencies) else self.step_s:.6f}")
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

    # which a task may extend

    def furnish(self) -> None:
        """Change the scene once, before the first episode."""

    def keep_still(self) -> None:
        """Write registers with which the program keeps the arm where it is; called before the program starts."""
        self.write(*[0.0] * 6)
        self.switch(False)

    # available to a task

    @property
    def state(self) -> "Snapshot":
        """The state of the controller, with the names of RTDE fields."""
        return self.robot.controller.snapshot

    @property
    def scene(self) -> "PhysicsWorld":
        """The objects around the arm: ``pose()``, ``poses()``, ``velocity()``."""
        world: Any = self.robot.controller.world
        found: PhysicsWorld = world
        return found

    def picture(self, camera: str) -> NDArray[np.uint8]:
        """What a camera of the scene sees (height, width, 3). Raises CameraError."""
        if self._cameras is None:
            self._cameras = open_cameras(self.scene)
        return self._cameras.rgb(camera)

    def move(self, name: str, pose: Vector6) -> None:
        """Move an object of the scene to a pose in the base frame. Raises WorldError for an unknown name."""
        if self.robot.controller.recorder is None:
            self.scene.move(name, pose)
        else:
            self.robot.move_object(name, pose)

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
        for i, value in enumerate(values, FIRST_REGISTER):
            if self.robot.controller.recorder is None:
                registers.set_double(i, float(value))
            else:
                self.robot.set_input_register("double", i, float(value))

    def switch(self, *levels: bool) -> None:
        """Write bit input registers, from `FIRST_BIT` on."""
        registers = self.robot.controller.registers.input
        for i, level in enumerate(levels, FIRST_BIT):
            if self.robot.controller.recorder is None:
                registers.set_bit(i, bool(level))
            else:
                self.robot.set_input_register("bit", i, float(level))

    # the interface of Gymnasium

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: robot and scene return to their initial state, which `arrange` varies."""
        super().reset(seed=seed)
        self._return(int(self.np_random.integers(_SEEDS)))
        self.arrange(options or {})
        self._begin()
        return self.observe(), {}

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Act, after the policy's latency, advance robot time by ``step_s`` in all, and observe."""
        waited = self._latencies[0] if len(self._latencies) == 1 else int(self.np_random.choice(self._latencies))
        if waited:
            self.robot.step(waited)
        self.act(action)
        if waited < self._periods:
            self.robot.step(self._periods - waited)
        reward, terminated, info = self.judge()
        if waited > self._periods:
            info = info | {"late": True}
        if self.stopped:
            terminated, info = True, info | {"stopped": self.stopped}
        return self.observe(), float(reward), terminated, False, info

    def render(self) -> NDArray[np.uint8] | None:
        """The image of the camera (height, width, 3). Raises CameraError if rendering is not available."""
        return None if self.render_mode is None else self.picture(self._camera)

    def close(self) -> None:
        """Release graphics memory."""
        if self._cameras is not None:
            self._cameras.close()
            self._cameras = None

    # episodes

    def _prepare(self) -> None:
        """Save the initial state of episodes, after the program has run once, because that compiles it."""
        self.furnish()
        self.robot.step(round(_SETTLING_S / self.robot.controller.period_s))
        self._begin()
        if not self._rest():
            raise TaskError(f"{type(self).__name__}: the arm does not stand still after its program was stopped")
        try:
            self._beginning = self.robot.save()
        except NotPossible as error:
            raise TaskError(f"{type(self).__name__}: {error}") from error

    def _begin(self) -> None:
        self.keep_still()
        if not self.robot.send_script(self._script):
            raise TaskError(f"{type(self).__name__}: its program does not start: {' '.join(self.robot.log(3))}")
        self.robot.step(1)

    def _return(self, seed: int) -> None:
        if not self._rest():
            self.close()
            self.robot = virtual_robot(self._model, **self._options)
            self._prepare()
        try:
            chances = self.robot.controller.chances
            self.robot.restore({**self._beginning, "chances": chances.begun(seed)})
            chances.restart(seed)  # also for streams that begin later
        except (NotPossible, BadArguments) as error:
            raise TaskError(f"{type(self).__name__}: {error}") from error

    def _rest(self) -> bool:
        """Stop everything, so that the state can be saved; False if that takes too long."""
        controller = self.robot.controller
        self.robot.dashboard("stop")
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
