"""Reads world files, MJCF and URDF as scenes around an arm."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from msgspec import Meta

from emulator.physics.description import Barrier, Camera, Mounted, moving_of, section
from emulator.physics.plan import (
    STEP_S,
    Cup,
    GripperShape,
    MountedShape,
    PhysicsPlan,
    Plate,
    parallel_gripper,
    robotiq_gripper,
)
from emulator.world.world import World, WorldError
from urproto.extras import how_to_install
from urproto.robotiq import GripperModel
from urproto.robots import RobotModel
from urproto.structures import converted
from urproto.worldfile import ObjectDescription, WorldFileError, read_description, read_world_file

if TYPE_CHECKING:
    from emulator.physics.cameras import Cameras
    from emulator.physics.world import PhysicsWorld

SHAPES: Final = ("plane", "box", "sphere", "cylinder", "mesh")
SCENE_FILES: Final = (".xml", ".urdf")
_GRIPPERS: Final = ("parallel", "suction", "changer")
_OF_MOUNTED: Final = {"mass", "colour"}
_STEP_S: Final[Any] = Annotated[float, Meta(ge=0.0001, le=0.004)]  # longer: contacts too soft to grip (guess)
_MAX_FRICTION: Final = 10.0  # as in a world of springs


@dataclass(frozen=True)
class ScenePlan(PhysicsPlan):
    """A plan that loads MuJoCo when it is used."""

    def build(self, model: RobotModel, period_s: float) -> "PhysicsWorld":
        from emulator.physics.scene import SceneError, build
        from emulator.physics.world import PhysicsWorld

        try:
            scene = build(self, model, period_s)
            return PhysicsWorld(self, model, scene)
        except SceneError as error:
            raise WorldError(f"{self.source}: {error}") from error

    def check(self, model: RobotModel, q: Sequence[float]) -> None:
        """Raise WorldError if the scene cannot be built around an arm at q [rad]."""
        from emulator.physics.scene import SceneError, build, check_start

        try:
            check_start(build(self, model, model.series.period_s), model, q)
        except SceneError as error:
            raise WorldError(f"{self.source}: {error}") from error


def open_cameras(world: World | None) -> "Cameras":
    """Open the cameras of a robot's world; close them after use. Raises CameraError without cameras or a renderer."""
    from emulator.physics.cameras import CameraError, Cameras
    from emulator.physics.world import PhysicsWorld

    if not isinstance(world, PhysicsWorld):
        raise CameraError("only a world with physics has cameras: start with --physics")
    return Cameras(world)


def read_physics(path: Path, gripper: GripperModel | None = None) -> ScenePlan:
    """Read a world file, or a MuJoCo (MJCF) or URDF file, as the scene around an arm with this gripper.

    Raises OSError, or WorldFileError that names the file and the place.
    """
    if find_spec("mujoco") is None:
        raise WorldFileError(f"{path} is a world with physics, which needs MuJoCo: {how_to_install('physics')}")
    try:
        plan = ScenePlan(path, scene=path) if path.suffix.lower() in SCENE_FILES else _read_world(path)
        if plan.scene is not None:
            plan.scene.open("rb").close()  # raises OSError for a missing file
        return replace(plan, gripper=None if gripper is None else robotiq_gripper(gripper))
    except WorldFileError:
        raise
    except ValueError as error:
        raise WorldFileError(f"{path}: {error}") from error


def _read_world(path: Path) -> ScenePlan:
    world = read_world_file(path, SHAPES)
    objects = {name: _resolve_mesh(path, _solid(name, thing)) for name, thing in world.objects.items()}
    moving = {name: moving_of(name, thing) for name, thing in objects.items()}
    for name, thing in objects.items():
        if thing.shape == "plane" and moving[name].mass is not None:
            raise ValueError(f"{name}: a plane is infinite: leave its mass out, or use a box")
    tools = [name for name, one in moving.items() if one.coupling is not None]
    scene = world.sections.get("scene")
    if scene is not None and not (isinstance(scene, str) and Path(scene).suffix.lower() in SCENE_FILES):
        raise ValueError(f"scene must be the name of a MuJoCo or URDF file, {' or '.join(SCENE_FILES)}")
    if world.tool is not None and world.tool.shape == "plane":
        raise ValueError("tool: a plane is infinite and cannot be a tool: use a sphere or a box")
    return ScenePlan(
        path,
        scene=None if scene is None else path.parent / scene,
        step_s=converted(world.sections.get("step", STEP_S), _STEP_S, "step"),
        objects=objects,
        moving=moving,
        tool=None if world.tool is None else _resolve_mesh(path, _solid("tool", world.tool)),
        **_mounted(path, world.sections.get("mounted") or {}, tools),
        barriers=section(world.sections, "barriers", Barrier),
        cameras=section(world.sections, "cameras", Camera),
    )


def _solid(name: str, thing: ObjectDescription) -> ObjectDescription:
    if not name:
        raise ValueError("an object must have a name")
    if not 0.0 <= thing.material.get("friction", 0.0) <= _MAX_FRICTION:
        raise ValueError(f"{name}: the friction must be from 0 to {_MAX_FRICTION:g}, not {thing.material['friction']}")
    if not all(0.0 < size < 1e3 for size in thing.sizes):
        raise ValueError(f"{name}: {thing.shape} must have lengths greater than 0, not {list(thing.sizes)}")
    return thing


def _resolve_mesh(path: Path, thing: ObjectDescription) -> ObjectDescription:
    """Find a mesh, relative to the folder of the world file."""
    if not thing.mesh:
        return thing
    mesh = path.parent / thing.mesh
    if not mesh.is_file():
        raise ValueError(f"the mesh {mesh} does not exist")
    return replace(thing, mesh=str(mesh.resolve()))


def _mounted(path: Path, given: Any, tools: Sequence[str]) -> dict[str, Any]:
    """Read the section of mounted parts, as keyword arguments of a plan. tools: names of objects with couplings."""
    if not isinstance(given, dict):
        raise ValueError("mounted must be a mapping from names")
    shapes: dict[str, tuple[ObjectDescription, MountedShape]] = {}
    cups: dict[str, Cup] = {}
    grippers: dict[str, GripperShape] = {}
    changers: dict[str, Plate] = {}
    for name, what in given.items():
        if isinstance(what, dict) and any(kind in what for kind in _GRIPPERS):
            mounted = converted(what, Mounted, name)
            if mounted.tool and mounted.tool not in tools:
                raise ValueError(
                    f"{name}: tool {mounted.tool!r} is not an object with a coupling: {', '.join(tools) or 'none'}"
                )
            if mounted.suction is not None:
                cups[str(name)] = Cup(mounted.suction, mounted.pose, mounted.tool)
            elif mounted.parallel is not None:
                grippers[str(name)] = parallel_gripper(str(name), mounted.parallel, mounted.pose, mounted.tool)
            elif mounted.changer is not None:
                changers[str(name)] = Plate(mounted.changer, mounted.pose)
            continue
        thing = _resolve_mesh(path, _solid(str(name), read_description(str(name), what, SHAPES)))
        if strange := set(thing.moving) - _OF_MOUNTED:
            raise ValueError(f"{name}: {min(strange)} is not possible for a part mounted on the flange")
        moving = moving_of(str(name), thing)
        shapes[str(name)] = thing, MountedShape(moving.mass or 0.0, thing.material.get("friction", 0.5), moving.colour)
    return {"mounted_shapes": shapes, "cups": cups, "output_grippers": grippers, "changers": changers}
