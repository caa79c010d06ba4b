"""``ur-client ros2-bridge``: a robot's controllers on topics of ROS 2, without ROS."""

from typing import Annotated

import typer

from client.commands.control import ControllersOption, MakeReady, Target, run, watch
from client.commands.following import PortOffset, RobotIP
from client.recording.extras import extra
from client.ros2.dds import check_namespace, check_prefix
from client.ros2.domain import Domain, read_domain

_CONTROLLER = "scaled_joint_trajectory_controller"


def ros2_bridge_command(
    names: Annotated[
        list[str] | None,
        typer.Argument(help=f"Controllers to begin with, besides those that only tell. [default: {_CONTROLLER}]"),
    ] = None,
    domain: Annotated[
        int | None, typer.Option("--domain", help="Number of the domain; without it ROS_DOMAIN_ID, else 0.")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Put before the topics, as left for /left/joint_states.")] = "",
    tf_prefix: Annotated[
        str, typer.Option("--tf-prefix", help="Put before the names of joints and frames, as left_.")
    ] = "",
    switch: Annotated[
        bool,
        typer.Option(
            "--switch/--no-switch",
            help="A command for a controller that is not active activates it if the arm rests, or is refused.",
        ),
    ] = True,
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Offer a robot to ROS 2: joint states, frames, I/O; trajectories and commands. Topics only, see docs/ros2.md."""
    target = Target(robot_ip, port_offset, controllers, make_ready, prefix=check_prefix(tf_prefix))
    where = read_domain(domain_id=domain)
    for note in where.notes:
        typer.echo(f"note: {note}", err=True)
    run(serve(target, where, check_namespace(namespace), names or [_CONTROLLER], switch))


async def serve(target: Target, domain: Domain, namespace: str, names: list[str], switching: bool) -> None:
    """Until it is cancelled, or no controller is left."""
    with extra("ros2", "the ROS 2 bridge"):
        from client.ros2.bridge import Bridge
        from client.ros2.dds import Participant
    with Participant(domain) as participant:
        async with (
            target.open() as robot,
            Bridge(robot, participant, namespace=namespace, prefix=target.prefix, switching=switching) as bridge,
        ):
            robot.activate(*bridge.broadcasters, *names)
            participant.start()
            typer.echo("\n".join(sorted(bridge.topics)))
            typer.echo(f"ROS 2 domain {domain.id}, {domain.reach}; topics as above. Ctrl-C ends it.", err=True)
            await watch(robot)
