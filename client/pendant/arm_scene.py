"""The 3D scene of the arm, built from the parameters of its model or from the user's meshes.

The axes of the scene are those of the robot's base. Joints are groups that rotate about their z axes, in the frames
given by the calibration of the arm. The browser rotates them (static/screen_arm.js), so only joint angles are sent when
the arm moves. It finds the groups by their names: "joint 0" to "joint 5", and "tcp". Objects that other modules add to
the scene stay when the arm changes.

The scene also shows the frames of the links, with the names from the ROS driver's URDF, the trace of the TCP, and the
target configuration as a ghost.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache
from math import hypot
from pathlib import Path
from typing import Any, Final, NamedTuple

from nicegui import app, ui
from nicegui.elements.scene.scene_object3d import Object3D

from client.calibration import parameters
from client.pendant.page import Page
from client.pendant.station import Station
from urproto.primary.subpackages import KinematicsInfo
from urproto.robots import CalibrationError
from urproto.robots.calibration import Chain, chain_of
from urproto.robots.description import MissingMeshesError, PlacedMesh, joint_frames, mesh_file, placed_meshes
from urproto.robots.model import RobotModel
from urproto.robots.pose import Pose, pose_inv, pose_trans, rotvec_to_matrix
from urproto.robots.shapes import Part, link_parts
from urproto.vectors import ZERO6, Matrix3, Vector3

_VISUAL: Final = (".glb", ".gltf", ".stl")  # formats that browsers can display, unlike ur_description's .dae
_COLLISION: Final = (".stl",)
_SEGMENTS: Final = 28
_BACKGROUND: Final = "#e9edf1"
_MESH_COLOR: Final = "#d9dde1"
_ROD_COLOR: Final = "#8a949d"
_ROD_RADIUS_M: Final = 0.005
_MIN_ROD_M: Final = 0.005
_AXES: Final = (("#d6453d", (1.0, 0.0, 0.0)), ("#3d9a4a", (0.0, 1.0, 0.0)), ("#2f6fd0", (0.0, 0.0, 1.0)))
_VIEWS: Final[dict[str, tuple[str, str, Vector3]]] = {  # text or icon, hint, direction from the arm to the camera
    "reset": ("3d_rotation", "Reset the view", (0.66, -0.68, 0.32)),
    "front": ("Front", "From the front, along -x", (1.0, 0.0, 0.02)),
    "side": ("Side", "From the side, along y", (0.0, -1.0, 0.02)),
    "top": ("Top", "From above, x to the right", (0.0, -0.001, 1.0)),
}
_FOV_DEG: Final = 38.0
_DISTANCE: Final = 3.3  # of the camera, in reaches
_TARGET_HEIGHT: Final = 0.5  # of the point that the camera looks at, in reaches
_TCP_RESOLUTION_M: Final = 1e-5
_TRACE_POINTS: Final = 3000  # of the TCP's path, at least a millimetre apart: 3 m or more
_TRACE_COLOR: Final = "#d81b8c"
_TREE_COLOR: Final = "#b8860b"
_GHOST_COLOR: Final = "#e07b00"
_GHOST_OPACITY: Final = 0.35
_GHOST_THRESHOLD_RAD: Final = 0.02  # guess: a ghost closer than a degree cannot be told from the arm
_LABEL: Final = "color:#1d2730;background:#ffffffd0;border-radius:3px;padding:0 3px;font-size:11px;white-space:nowrap"
_ROTATION_DIGITS: Final = 6


class ServedMesh(NamedTuple):
    """The mesh of one link. url: its address on this pendant."""

    url: str
    placed: PlacedMesh

    @property
    def is_stl(self) -> bool:
        """Whether the file lacks colours."""
        return self.url.endswith(".stl")


@cache
def served_meshes(folder: Path, model: RobotModel) -> tuple[ServedMesh, ...]:
    """Meshes from base to wrist 3, from the folder or its subfolder of the model's name. Raises MissingMeshesError."""
    model_folder = folder / model.name
    mesh_folder = model_folder if model_folder.is_dir() else folder
    return tuple(_served_mesh(mesh_folder, model, mesh) for mesh in placed_meshes(model))


def _served_mesh(folder: Path, model: RobotModel, mesh: PlacedMesh) -> ServedMesh:
    try:
        file = mesh_file(folder, "visual", mesh.name, _VISUAL)
    except MissingMeshesError:
        file = mesh_file(folder, "collision", mesh.name, _COLLISION)
    url = f"/meshes/{model.name}/{mesh.name}{file.suffix}"
    app.add_static_file(local_file=file, url_path=url)
    return ServedMesh(url, mesh)


class Lathe(Object3D, component=Path(__file__).with_name("static") / "lathe.js"):
    """A solid of revolution about its z axis. profile: (radius, z), from bottom to top."""

    def __init__(self, profile: Sequence[tuple[float, float]]) -> None:
        super().__init__([list(point) for point in profile], _SEGMENTS)


class TcpTrace(Object3D, component=Path(__file__).with_name("static") / "tcp_trace.js"):
    """The trace of the TCP: static/screen_arm.js adds a point each time the TCP has moved by a millimetre."""

    def __init__(self) -> None:
        super().__init__(_TRACE_POINTS)


_BASE, _INERTIA, _TCP = "base", "base_link_inertia", "tcp"  # frames


def link_frames(model: RobotModel) -> list[dict[str, Pose]]:
    """The URDF frames at the base and at each moving link, relative to the frame of that link."""
    joints = joint_frames(model)
    moving = [joint.child for joint in joints if joint.moves]
    fixed = {joint.child: joint for joint in joints if not joint.moves}
    from_base = pose_inv(fixed[_BASE].pose)
    inertia = pose_trans(from_base, fixed[_INERTIA].pose)
    tool_frames: dict[str, Pose] = {moving[-1]: ZERO6}
    for name, joint in fixed.items():
        if joint.parent in tool_frames:
            tool_frames[name] = pose_trans(tool_frames[joint.parent], joint.pose)
    base: dict[str, Pose] = {fixed[_BASE].parent: from_base, _BASE: ZERO6, _INERTIA: inertia}
    return [base, *({name: ZERO6} for name in moving[:-1]), tool_frames]


class ArmScene(ui.scene):
    """A scene with the arm. arm: the drawn arm. preview: the target configuration for the ghost [rad], or None."""

    arm: "DrawnArm"
    trace: Object3D

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.preview: Callable[[], Sequence[float] | None] = lambda: None
        self.ghost_shown = True

    def ghost(self, station: Station) -> list[float] | None:
        """The target configuration [rad], None if it equals the actual one."""
        actual = station.values.get("actual_q")
        target = self.preview() or station.values.get("target_q")
        if actual is None or target is None or not self.ghost_shown:
            return None
        differs = any(abs(a - b) > _GHOST_THRESHOLD_RAD for a, b in zip(actual, target, strict=True))
        return [round(angle, 4) for angle in target] if differs else None


def arm_scene(page: Page) -> ArmScene:
    """A scene with the arm, which appears once its model is known."""
    camera = ui.scene.perspective_camera(fov=_FOV_DEG, near=0.02, far=60.0)
    scene = ArmScene(grid=(4, 40), camera=camera, background_color=_BACKGROUND, fps=30).classes("arm")
    ui.label("Loading the 3D view ...").classes("arm-loading").props("role=status")
    ui.run_javascript(f"pendant.addScene({scene.id})")
    arm = scene.arm = DrawnArm(scene, page.station.meshes, page.show_error)
    ghost = DrawnArm(scene, ghost=True)
    with scene:
        scene.trace = TcpTrace().with_name("trace").material(_TRACE_COLOR).visible(False)

    def set_model(model_and_kinematics: tuple[RobotModel | None, KinematicsInfo | None]) -> None:
        arm.set_model(*model_and_kinematics)
        ghost.set_model(*model_and_kinematics)

    page.live.effect(lambda station: (station.model, station.core.kinematics), set_model)
    page.live.effect(_tcp_offset, arm.set_tcp)
    page.live.bind(scene, "value", lambda station: station.values.get("actual_q"))
    page.live.bind(scene, "ghost", scene.ghost)
    return scene


def camera_buttons(page: Page, scene: ui.scene) -> None:
    """Buttons that choose the point of view and what is drawn in addition to the arm."""
    with ui.row().classes("camera-buttons"):
        if isinstance(scene, ArmScene):
            _display_buttons(scene)
        for name, (label, hint, direction) in _VIEWS.items():

            def move_camera(_: object, direction: Vector3 = direction) -> None:
                if page.station.model is not None:
                    _move_camera(scene, page.station.model, direction)

            button = ui.button(on_click=move_camera, color=None).props(f"flat dense no-caps data-testid=view-{name}")
            if name == "reset":
                button.set_icon(label)
            else:
                button.set_text(label)
            button.tooltip(hint).props(f'aria-label="{hint}"')


def _display_buttons(scene: ArmScene) -> None:
    def ghost(shown: bool) -> None:
        scene.ghost_shown = shown

    def trace(shown: bool) -> None:
        scene.trace.visible(shown)
        clear.set_visibility(shown)

    _toggle_button("account_tree", "Frames as in the URDF", "frames", scene.arm.show_frames)
    _toggle_button("layers", "Ghost of the arm at the target", "ghost", ghost, on=True)
    _toggle_button("timeline", "Path of the TCP", "trace", trace)
    clear = ui.button(
        icon="delete_sweep", color=None, on_click=lambda: ui.run_javascript(f"pendant.clearTrace({scene.id})")
    )
    clear.props('flat dense aria-label="Clear the path of the TCP" data-testid=trace-clear').tooltip("Clear the path")
    clear.set_visibility(False)


def _toggle_button(icon: str, name: str, test_id: str, on_toggle: Callable[[bool], object], on: bool = False) -> None:
    pressed = [on]

    def click() -> None:
        pressed[0] = not pressed[0]
        button.props(f"aria-pressed={str(pressed[0]).lower()}")
        on_toggle(pressed[0])

    button = ui.button(icon=icon, color=None, on_click=click).tooltip(name)
    button.props(f'flat dense aria-label="{name}" aria-pressed={str(on).lower()} data-testid=show-{test_id}')


def chain(model: RobotModel, kinematics: KinematicsInfo | None) -> Chain:
    """The joint frames of the arm, calibrated if the robot has reported its calibration."""
    if kinematics is not None:
        try:
            return chain_of(parameters(kinematics))
        except CalibrationError:  # invalid; a nominal arm is better than none
            pass
    return chain_of(model.dh if model.calibration is None else model.calibration)


@dataclass(slots=True)
class DrawnArm:
    """The arm in a scene. meshes: the user's folder of meshes. on_error: called with the reason if they are unusable.

    ghost: draw a transparent ghost instead, which is hidden until the browser has joint angles for it. Its group is
    "ghost", with joints "ghost joint 0" and so on; it has no frames, no TCP and no meshes.
    """

    scene: ui.scene
    meshes: Path | None = None
    on_error: Callable[[str], None] = print
    ghost: bool = False
    _frames: list[Object3D] = field(default_factory=list)
    _frames_shown: bool = False
    _model: RobotModel | None = None
    _root: Object3D | None = None
    _flange: Object3D | None = None
    _tcp: Object3D | None = None
    _offset: tuple[float, ...] = (0.0,) * 6
    _camera_placed: bool = False

    def set_model(self, model: RobotModel | None, kinematics: KinematicsInfo | None) -> None:
        """Draw another arm, or the same arm with another calibration."""
        if self._root is not None:
            self._root.delete()
            self._root = self._flange = self._tcp = None
            self._frames.clear()
        self._model = model
        if model is None:
            return
        links = self._links(model)
        with self.scene, self.scene.group() as self._root, ExitStack() as nested:
            links[0](self.scene)
            if self.ghost:
                self._root.with_name("ghost").visible(False)
            else:
                _axes(self.scene, 0.16 * model.reach_m)
            frames = link_frames(model)
            for i, (position, axes) in enumerate(chain(model, kinematics)):
                if not self.ghost:
                    self._draw_frames(frames[i], position)
                nested.enter_context(self.scene.group().move(*position).rotate_R(_matrix_rows(axes)))
                name = f"ghost joint {i}" if self.ghost else f"joint {i}"
                self._flange = nested.enter_context(self.scene.group().with_name(name))
                links[i + 1](self.scene)
            if not self.ghost:
                self._draw_frames(frames[-1])
        if self.ghost:
            return
        self.set_tcp(self._offset)
        if not self._camera_placed:
            _move_camera(self.scene, model, _VIEWS["reset"][2], duration=0.0)
            self._camera_placed = True

    def show_frames(self, shown: bool) -> None:
        """Show or hide the frames of all links, their names, and the lines between them."""
        self._frames_shown = shown
        for frame in self._frames:
            frame.visible(shown)

    def _draw_frames(self, frames: Mapping[str, Pose], child: Vector3 | None = None) -> None:
        """Draw frames at the origin of the current group, and a line from there to the start of the next link."""
        assert self._model is not None
        length = 0.1 * self._model.reach_m
        with self.scene.group() as group:
            rotations = (tuple(round(part, _ROTATION_DIGITS) + 0.0 for part in pose[3:]) for pose in frames.values())
            for rotation in dict.fromkeys(rotations):  # frames with the same orientation are drawn once
                with self.scene.group().rotate_R(_matrix_rows(rotvec_to_matrix(*rotation))):
                    _axes(self.scene, length)
            height = 1.2 if _TCP in frames else 0.2  # the label of tool0 may be at the same position
            self.scene.text(", ".join(frames), _LABEL).move(0.0, 0.0, height * length)
            if child is not None and any(child):
                self.scene.line([0.0, 0.0, 0.0], list(child)).material(_TREE_COLOR)
        group.visible(self._frames_shown)
        self._frames.append(group)

    def _links(self, model: RobotModel) -> "list[_Link]":
        if self.ghost:
            return [_Link(parts, ghost=True) for parts in link_parts(model)]
        if self.meshes is not None:
            try:
                return [_Link(mesh=mesh) for mesh in served_meshes(self.meshes, model)]
            except MissingMeshesError as error:
                self.on_error(str(error))
        return [_Link(parts) for parts in link_parts(model)]

    def set_tcp(self, offset: Sequence[float]) -> None:
        """Draw axes at the TCP and a rod from the flange to it. offset: flange to TCP (6,) [m, rotation vector]."""
        self._offset = tuple(offset)
        if self._tcp is not None:
            self._tcp.delete()
            self._tcp = None
        if self._flange is None or self._model is None:
            return
        x, y, z, *rotation = self._offset
        with self.scene, self._flange, self.scene.group() as self._tcp:
            length = hypot(x, y, z)
            if length > _MIN_ROD_M:
                rod = Lathe(((0.0, 0.0), (_ROD_RADIUS_M, 0.0), (_ROD_RADIUS_M, length), (0.0, length)))
                rod.rotate_R(_matrix_rows(_rotation_to((x / length, y / length, z / length)))).material(_ROD_COLOR, 0.7)
            with self.scene.group().move(x, y, z).with_name("tcp") as point:
                point.rotate_R(_matrix_rows(rotvec_to_matrix(*rotation)))
                _axes(self.scene, 0.2 * self._model.reach_m)
                self._frames = [frame for frame in self._frames if frame.id in self.scene.objects]
                self._draw_frames({_TCP: ZERO6})


@dataclass(frozen=True, slots=True)
class _Link:
    """Adds the shapes or the mesh of a link to the current group."""

    parts: Sequence[Part] = ()
    mesh: ServedMesh | None = None
    ghost: bool = False

    def __call__(self, scene: ui.scene) -> None:
        for part in self.parts:
            solid = Lathe(part.profile).move(*part.origin)
            solid.material(*(_GHOST_COLOR, _GHOST_OPACITY) if self.ghost else (part.color,))
            solid.rotate_R(_matrix_rows(_rotation_to(part.axis)))
        if self.mesh is not None:
            url, placed = self.mesh
            mesh = scene.stl(url).material(_MESH_COLOR) if self.mesh.is_stl else scene.gltf(url)
            mesh.move(*placed.position).rotate(*placed.rpy)


def _move_camera(scene: ui.scene, model: RobotModel, direction: Vector3, duration: float = 0.4) -> None:
    distance, height = _DISTANCE * model.reach_m, _TARGET_HEIGHT * model.reach_m
    x, y, z = (distance * part / hypot(*direction) for part in direction)
    scene.move_camera(x, y, z + height, 0.0, 0.0, height, duration=duration)


def _axes(scene: ui.scene, length: float) -> None:
    """Draw axes: x red, y green, z blue."""
    shaft_radius, tip_length = 0.012 * length, 0.2 * length
    for color, axis in _AXES:
        with scene.group().rotate_R(_matrix_rows(_rotation_to(axis))):
            Lathe(
                ((0.0, 0.0), (shaft_radius, 0.0), (shaft_radius, length - tip_length), (0.0, length - tip_length))
            ).material(color)
            Lathe(((0.0, length - tip_length), (3.2 * shaft_radius, length - tip_length), (0.0, length))).material(
                color
            )


def _tcp_offset(station: Station) -> tuple[float, ...]:
    offset: Sequence[Any] = station.values.get("tcp_offset") or (0.0,) * 6
    return tuple(round(value / _TCP_RESOLUTION_M) * _TCP_RESOLUTION_M for value in offset)


def _rotation_to(axis: Vector3) -> Matrix3:
    """A rotation that maps z to an axis."""
    x, y, z = axis
    radial = hypot(x, y)
    if radial < 1e-9:
        return (1.0, 0.0, 0.0, 0.0, z, 0.0, 0.0, 0.0, z)
    # x' = (-y, x, 0) / side, y' = axis x x'
    return (-y / radial, -x * z / radial, x, x / radial, -y * z / radial, y, 0.0, radial, z)


def _matrix_rows(matrix: Matrix3) -> list[list[float]]:
    return [list(matrix[i : i + 3]) for i in (0, 3, 6)]
