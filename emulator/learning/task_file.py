"""Tasks as folders: ``task.yaml`` says what is to be reached, and ``scene.yaml`` is the world file around the arm.

Places are given for every arm at once: x and y as shares of its reach, heights in m above the base. So each arm has a
task of its own size, within its reach.
"""

from pathlib import Path
from typing import Annotated, Final, TypeAlias

from msgspec import Meta, Struct, field
from numpy.random import Generator

from urproto.robots import RobotModel
from urproto.structures import InvalidYamlError, converted, load_yaml
from urproto.vectors import ZERO3, ZERO6, Vector3, Vector6

TASKS: Final = Path(__file__).with_name("tasks")
TASK_FILE: Final = "task.yaml"
SCENE_FILE: Final = "scene.yaml"
GOAL: Final = "goal"

_Share: TypeAlias = Annotated[float, Meta(ge=-1.0, le=1.0)]
_Height: TypeAlias = Annotated[float, Meta(ge=-2.0, le=2.0)]
_Length: TypeAlias = Annotated[float, Meta(gt=0.0, le=2.0)]
_Span: TypeAlias = tuple[_Share, _Share]


class TaskError(ValueError):
    """The task is invalid: its file, an option, its program does not start, or its robot cannot begin an episode."""


class Region(Struct, forbid_unknown_fields=True):
    """A box. x, y: from and to, as shares of the reach; z_m: its lower side [m]; up: its height, as a share."""

    x: _Span
    y: _Span
    z_m: _Height
    up: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0

    def corners(self, model: RobotModel) -> tuple[Vector3, Vector3]:
        """The lowest and the highest corner for an arm, in the base frame [m]."""
        (x0, x1), (y0, y1), reach_m = self.x, self.y, model.reach_m
        return (
            (min(x0, x1) * reach_m, min(y0, y1) * reach_m, self.z_m),
            (max(x0, x1) * reach_m, max(y0, y1) * reach_m, self.z_m + self.up * reach_m),
        )

    def draw(self, model: RobotModel, chance: Generator) -> Vector3:
        """A random point in it, in the base frame [m]."""
        x, y, z = (float(chance.uniform(*along)) for along in zip(*self.corners(model), strict=True))
        return (x, y, z)


class GoalRegion(Region, forbid_unknown_fields=True):
    """Where goals are. lying: the share of goals that are on its lower side."""

    lying: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0

    def draw(self, model: RobotModel, chance: Generator) -> Vector3:
        x, y, z = super().draw(model, chance)
        return (x, y, self.z_m if chance.random() < self.lying else z)


class PointOfObject(Struct, forbid_unknown_fields=True):
    """A point of an object, in the object's frame [m]."""

    of: str
    offset: Vector3 = ZERO3


class GripperPins(Struct, forbid_unknown_fields=True):
    """A gripper of the scene: the digital output that closes it, and the digital input of one that holds something."""

    output: Annotated[int, Meta(ge=0, le=7)] = 0
    holding: Annotated[int, Meta(ge=0, le=7)] = 1


class PayloadOfTask(Struct, forbid_unknown_fields=True):
    """What is on the flange: mass [kg], and its centre of gravity in the flange frame [m]."""

    mass: Annotated[float, Meta(ge=0.0, le=50.0)]
    cog: Vector3 = ZERO3


class Task(Struct, forbid_unknown_fields=True, kw_only=True):
    """A task: to bring the TCP, or the object ``moved``, within ``distance_m`` of the goal.

    workspace: where the TCP may be commanded to. goal, or goal_at: where goals are, or the point of an object that is
    the goal. places: where objects are at the beginning. apart_m: the least
    distance between their places, and that of the goal, at the beginning. gripper: None for a tool without one.
    forces: whether the forces at the TCP are observed. steps: of an episode.
    """

    workspace: Region
    distance_m: _Length
    goal: GoalRegion | None = None
    goal_at: PointOfObject | None = None
    moved: str = ""
    places: dict[str, Region] = field(default_factory=dict)
    apart_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.0
    gripper: GripperPins | None = None
    forces: bool = False
    tcp: Vector6 = ZERO6
    payload: PayloadOfTask | None = None
    steps: Annotated[int, Meta(ge=1, le=100_000)] = 200

    def __post_init__(self) -> None:
        if (self.goal is None) == (self.goal_at is None):
            raise ValueError("it needs either goal or goal_at")
        if self.moved and self.moved not in self.places:
            raise ValueError(f"places needs {self.moved!r}, which is to be moved")


def find_task(name: str) -> Path:
    """The folder of a task: one of the tasks that come with the emulator, such as ``reach``, or a folder of yours."""
    folder = Path(name)
    if (folder / TASK_FILE).is_file():
        return folder
    if (TASKS / name / TASK_FILE).is_file():
        return TASKS / name
    known = ", ".join(sorted(path.parent.name for path in TASKS.glob(f"*/{TASK_FILE}")))
    raise TaskError(f"there is no task {name!r}: choose {known}, or a folder with {TASK_FILE} and {SCENE_FILE}")


def read_task(folder: Path) -> Task:
    """Read the task of a folder. Raises TaskError, which names the file and the place, or OSError."""
    path = folder / TASK_FILE
    try:
        content = load_yaml(path.read_bytes())
    except InvalidYamlError as error:
        raise TaskError(f"{path} is not YAML: {error}") from error
    return converted(content, Task, path, TaskError)
