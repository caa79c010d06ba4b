"""``ur-client plan``: plan a collision-free path around obstacles, and execute it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from client.commands.control import ArmAccess, MakeReady, RecordOption, Seen, Target, follow, print_result, run
from client.commands.following import PortOffset, RobotIP
from client.commands.planning_goals import angles, constraints, parse_item
from client.commands.record import Overwrite, check_free
from client.commands.scene_drawing import model_named
from client.controllers import JOINT_NAMES, JointTrajectory, Result
from client.recording import Recorder
from client.robot import AsyncRobot
from urproto.commandline import AsJson, print_json
from urproto.robots.pose import Pose
from urproto.vectors import ZERO6

if TYPE_CHECKING:
    from client.planning import Limits, Plan, PlanningScene


def plan_command(
    goals: Annotated[
        list[str],
        typer.Argument(
            metavar="GOAL...",
            help='Joint angles "0,-1.57,0,-1.57,0,0" [rad], a pose of the TCP "p[0.3,0.1,0.2,0,3.14,0]" [m, rotation '
            'vector], a named configuration (home, up, test_configuration), or any one of several: "up or home". '
            'Several goals form a sequence, each with its own planner if you name one: "LIN p[...] blend=0.03" '
            '"CIRC p[...] interim=0.3,0.1,0.2".',
        ),
    ],
    scene: Annotated[
        Path | None, typer.Option(help="Obstacles around the arm: a world file, as for `ur-emulator --world`.")
    ] = None,
    safety: Annotated[
        Path | None, typer.Option(help="Stay inside the safety planes of this PolyScope installation file.")
    ] = None,
    execute: Annotated[bool, typer.Option("--execute", help="Have the robot execute the plan.")] = False,
    degrees: Annotated[bool, typer.Option("--degrees", help="Joint angles are in degrees.")] = False,
    padding: Annotated[float, typer.Option(help="Clearance that the arm keeps from everything [m].")] = 0.01,
    planner: Annotated[
        str,
        typer.Option(
            help="RRTConnect, RRTstar, PRM: around obstacles. PTP: straight in joint space; LIN: a line of the TCP; "
            "CIRC: an arc."
        ),
    ] = "RRTConnect",
    keep_orientation: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,Z",
            help="Keep the TCP's orientation of the start, within these tolerances about its x, y and z [rad]; "
            "0.1,0.1,3.15 keeps it level.",
        ),
    ] = None,
    keep_within: Annotated[
        str | None,
        typer.Option(
            metavar="DX,DY,DZ,X,Y,Z", help="Keep the TCP in a box, given by its edge lengths and its centre [m]."
        ),
    ] = None,
    time_limit: Annotated[float, typer.Option(help="Time limit of the search [s].")] = 5.0,
    seed: Annotated[int, typer.Option(help="The same seed gives the same path.")] = 0,
    velocity: Annotated[float, typer.Option(help="Share of the joints' speed limits, up to 1.")] = 0.3,
    acceleration: Annotated[float, typer.Option(help="Share of the acceleration limits, up to 1.")] = 0.3,
    jerk: Annotated[
        float | None,
        typer.Option(min=1.0, max=1e6, help="Highest jerk of a joint [rad/s³] (default: 200), times --acceleration."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="Plot joint angles and speeds into this file (.png, .pdf).")] = None,
    markers: Annotated[
        Path | None, typer.Option(help="Write motion, scene and path as markers for Foxglove to this file (.mcap).")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="Joint angles to start from, to plan without a robot; needs --model.", show_default=False),
    ] = None,
    model: Annotated[str | None, typer.Option(help="The arm, to plan without a robot: ur3, ur5e ...")] = None,
    controller: Annotated[
        str, typer.Option(help="Trajectory controller to use.")
    ] = "passthrough_trajectory_controller",
    make_ready: MakeReady = False,
    record: RecordOption = None,
    overwrite: Overwrite = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
    as_json: AsJson = False,
) -> None:
    """Plan a collision-free path around obstacles, and execute it with --execute."""
    if (start is None) != (model is None):
        raise typer.BadParameter("--start and --model together plan without a robot: give both or neither")
    if start is not None and execute:
        raise typer.BadParameter("--execute needs a robot: leave out --start and --model")
    if record is not None and not execute:
        raise typer.BadParameter("--record records an execution: add --execute, or draw the plan with --markers")
    if markers is not None and markers.suffix.lower() != ".mcap":
        raise typer.BadParameter(f"--markers writes .mcap files, which {markers} is not")
    for file in (record, markers):
        if file is not None:
            check_free(file, overwrite)
    drawn = record is not None and record.suffix.lower() == ".mcap"  # other formats cannot contain markers
    options: dict[str, Any] = {
        "time_limit_s": time_limit,
        "seed": seed,
        "velocity_scaling": velocity,
        "acceleration_scaling": acceleration,
    }

    async def work() -> None:
        from client.planning import Planner, PlanningScene

        items = [parse_item(goal, planner, degrees) for goal in goals]
        if start is not None and model is not None:
            around = PlanningScene(model_named(model), padding_m=padding)
            _surround(around, scene, safety)
            begin = angles(start, degrees)
            kept = constraints(around, begin, ZERO6, keep_orientation, keep_within)
            alone = Planner(around, _limits(around, jerk))
            plan = alone.plan_sequence(begin, items, path_constraints=kept, **options)
            _report(plan, as_json, plot)
            _draw(plan, around, markers)
            return

        target = Target(robot_ip, port_offset, make_ready=make_ready, record=record)
        async with AsyncRobot(robot_ip, robot_ports=target.ports) as robot:
            tcp = robot.planning.tcp_offset()
            around = PlanningScene(await robot.planning.model(), padding_m=padding)
            _surround(around, scene, safety, tcp)
            kept = constraints(around, robot.q, tcp, keep_orientation, keep_within)
            options["limits"] = _limits(around, jerk)
            plan = await robot.planning.plan_sequence(items, around, path_constraints=kept, **options)
        _report(plan, as_json, plot)
        _draw(plan, around, markers)
        if execute:
            result = await _execute(plan, target, controller, around if drawn else None)
            print_result("plan", result, err=as_json)

    run(work())


async def _execute(plan: "Plan", target: Target, controller: str, drawn: "PlanningScene | None") -> Result:
    """Have the robot execute a plan. drawn: the scene to draw into the recording, together with the path."""
    planned = plan.trajectory
    samples = (values.tolist() for values in (planned.times_s, planned.q, planned.qd, planned.qdd))
    async with target.open() as arm:
        state = await arm.request("robot_state")
        current = state["positions"]  # by name, with the manager's prefix, base to wrist 3
        plan.check_start(list(current.values()))
        await target.activate(arm, controller)
        trajectory = JointTrajectory.sampled(tuple(current), *samples)
        if drawn is None:
            return await follow(arm, controller, trajectory, "plan")
        draw = _drawer(arm, drawn, plan)
        await draw(state)
        return await follow(arm, controller, trajectory, "plan", draw)


def _drawer(arm: ArmAccess, scene: "PlanningScene", plan: "Plan") -> Seen:
    """A callback that draws the scene and the path into the recording of the robot's states."""
    from client.planning.markers import SceneDrawing

    drawing = SceneDrawing(scene, plan.trajectory.q)

    async def draw(state: Mapping[str, Any]) -> None:
        for topic, markers in drawing.at(state["time_s"], list(state["positions"].values())):
            await arm.request("record_markers", topic=topic, markers=markers)

    return draw


def _limits(scene: "PlanningScene", jerk: float | None) -> "Limits":
    """The arm's default limits, with this jerk [rad/s3] if one is given."""
    from client.planning import default_limits

    return default_limits(scene.model) if jerk is None else default_limits(scene.model, jerk)


def _surround(scene: "PlanningScene", world: Path | None, safety: Path | None, tcp_offset: Pose = ZERO6) -> None:
    """Add the objects of a world file, and the safety planes of an installation file."""
    from client.planning import read_safety

    if world is not None:
        with _reading(world):
            scene.update(world, tcp_offset)
    if safety is not None:
        with _reading(safety):
            scene.set_safety(read_safety(safety), tcp_offset)


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise typer.BadParameter(f"cannot read {path}: {error.strerror}") from error


def _report(plan: "Plan", as_json: bool, plot: Path | None) -> None:
    if plot is not None:
        from client.recording.plots import draw_trajectory

        draw_trajectory(plan.trajectory.times_s, plan.trajectory.q, plan.trajectory.qd, plot)
    if as_json:
        print_json(_as_json(plan))
        return
    corners = len(plan.path) - 2
    how = f"with {corners} corner{'s' if corners > 1 else ''}" if corners else "straight to the goal"
    typer.echo(
        f"a path of {plan.duration_s:.2f} s {how}, by "
        f"{plan.planner}: found in {1000 * plan.search_s:.0f} ms, shortcut in {1000 * plan.shortcutting_s:.0f} ms, "
        f"parameterised in {1000 * plan.parameterisation_s:.0f} ms"
    )


def _draw(plan: "Plan", scene: "PlanningScene", path: Path | None) -> None:
    """Write the motion over time, with the scene around it."""
    if path is None:
        return
    from client.planning.markers import SceneDrawing

    trajectory = plan.trajectory
    with Recorder(path, ("timestamp", "actual_q", "actual_qd"), {"made_by": "ur-client plan"}) as recorder:
        draw = SceneDrawing(scene, trajectory.q).onto(recorder)
        for time_s, q, qd in zip(
            trajectory.times_s.tolist(), trajectory.q.tolist(), trajectory.qd.tolist(), strict=True
        ):
            state = {"timestamp": time_s, "actual_q": q, "actual_qd": qd}
            recorder.write(state)
            draw(state)


def _as_json(plan: "Plan") -> dict[str, Any]:
    trajectory = plan.trajectory
    return {
        "planner": plan.planner,
        "duration_s": plan.duration_s,
        "path": plan.path,
        "joint_names": JOINT_NAMES,
        "times_s": trajectory.times_s.tolist(),
        "positions": trajectory.q.tolist(),
        "velocities": trajectory.qd.tolist(),
        "accelerations": trajectory.qdd.tolist(),
    }
