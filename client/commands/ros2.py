"""``ur-client ros2``: the nodes of the official ROS 2 driver for a robot, on rclpy."""

import asyncio
import sys
from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from client.commands.cameras import CameraNames, CameraOptions, CameraPort, CameraRate
from client.commands.control import ControllersOption, Headless, InitialController, MakeReady, controllers_file, run
from client.commands.following import PortOffset, RobotIP
from client.dashboard import DashboardClient
from client.driver.config import read_settings, robot_ports
from client.errors import Ros2Error
from urproto.errors import URError
from urproto.ports import CAMERA_PORT
from urproto.robotiq import MODELS
from urproto.robotiq import PORT as GRIPPER_PORT
from urproto.text import unknown

if TYPE_CHECKING:
    import socket

    from client.driver import DriverConfig
    from client.ros2.message_packages import MessagePackages
    from client.ros2.options import DriverOptions

_CAMERA_HZ = 10.0
_RETRY_S = 0.5  # between attempts to reach a dashboard (guess)
_SIM_TIME = {"silence_s": 600.0, "keep_alive_timeout_s": 2.0}  # guess: time may stand still, or pass ten times as fast
_SWITCH_INTERVAL_S = 0.0005  # between threads: with Python's 5 ms, a busy callback would delay a command


class _Only(str, Enum):
    DASHBOARD_CLIENT = "dashboard_client"


def ros2_command(
    ros_arguments: Annotated[
        list[str] | None,
        typer.Argument(metavar="[-- ROS_ARGUMENTS]", help="Arguments for ROS, such as -r or --params-file."),
    ] = None,
    controller: InitialController = None,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain, instead of ROS_DOMAIN_ID.")] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of all nodes: left gives /left/joint_states.")] = "",
    tf_prefix: Annotated[
        str, typer.Option(help="Prefix for the names of joints, frames and interfaces, such as left_.")
    ] = "",
    headless: Headless = True,
    setup: Annotated[
        bool,
        typer.Option(
            "--setup",
            help="Build the message packages missing from this ROS 2 installation, write packages with the official "
            "launch files, print the file to source, and exit.",
        ),
    ] = False,
    gripper: Annotated[
        str, typer.Option(help="Gripper on the arm: robotiq-2f-85, robotiq-2f-140 or robotiq-hand-e.")
    ] = "",
    gripper_port: Annotated[
        int | None, typer.Option(help="Port of the gripper's software, if not the usual one.")
    ] = None,
    camera: CameraNames = None,
    camera_rate: CameraRate = _CAMERA_HZ,
    camera_port: CameraPort = None,
    controllers: ControllersOption = None,
    dashboard_client: Annotated[bool, typer.Option(help="Whether there is a node dashboard_client.")] = True,
    robot_state_publisher: Annotated[
        bool, typer.Option(help="Whether there is a node robot_state_publisher; not with a description of your own.")
    ] = True,
    use_sim_time: Annotated[
        bool,
        typer.Option("--use-sim-time", help="Stamp messages with the robot's time and publish it as /clock."),
    ] = False,
    only: Annotated[
        _Only | None, typer.Option(help="Run only this node, for a robot that another driver moves.")
    ] = None,
    ur_type: Annotated[str, typer.Option(help="Refuse a robot of another type than this, such as ur5e.")] = "",
    driver: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Setting of DriverConfig, such as reverse_port=50011."),
    ] = None,
    make_ready: MakeReady = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Run the ROS 2 driver: nodes, topics, services and actions as in ur_robot_driver. See docs/ros2.md."""
    cameras = CameraOptions(robot_ip, camera_port or CAMERA_PORT + port_offset, camera or (), camera_rate)
    if gripper and gripper not in MODELS:
        raise typer.BadParameter(f"--gripper: {unknown('gripper', gripper, MODELS)}")
    try:
        settings = read_settings(driver or ())
    except ValueError as error:
        raise typer.BadParameter(f"--driver {error}") from None
    if setup:
        write_packages(prepare())
        return
    from client.ros2.control_process import control_process
    from client.ros2.options import DriverOptions

    options = DriverOptions(
        robot_ip,
        {
            "robot_ports": robot_ports(port_offset),
            **(_SIM_TIME if use_sim_time else {}),
            **settings,
        },
        controllers_file(controllers, tf_prefix),
        controller=controller,
        tf_prefix=tf_prefix,
        headless=headless,
        make_ready=make_ready,
        ur_type=ur_type,
        dashboard_client=dashboard_client,
        robot_state_publisher=robot_state_publisher,
        use_sim_time=use_sim_time,
        namespace=namespace,
        domain=domain,
        gripper=gripper,
        gripper_port=gripper_port or GRIPPER_PORT + port_offset,
        cameras=tuple(cameras.names),
        camera_port=cameras.port,
        camera_hz=cameras.rate_hz,
        ros_arguments=tuple(argument for argument in ros_arguments or () if argument != "--ros-args"),
    )
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    if only is not None:
        prepare()
        run(serve_dashboard(options), interrupted=0)
        return
    with control_process() as link:  # starts meanwhile
        packages = prepare()
        if packages.setup_file is not None:
            typer.echo(f"to use the message packages in other programs: . {packages.setup_file}", err=True)
        run(serve(options, link), interrupted=0)  # as nodes do, for launch


def write_packages(messages: "MessagePackages") -> None:
    """Write the packages with the launch files, and print how to use them. Raises Ros2Error."""
    from client.ros2.overlay import write_overlay

    try:
        typer.echo(f"source {write_overlay(messages)}")
    except OSError as error:
        raise Ros2Error(f"cannot write the launch files: {error}") from error


def prepare() -> "MessagePackages":
    """Make rclpy and all message packages importable; build those that are missing. Raises Ros2Error."""
    from client.ros2 import message_packages

    if not message_packages.missing():
        return message_packages.MessagePackages()
    console = Console(stderr=True)
    with Progress(TextColumn("{task.description}"), BarColumn(), console=console, transient=True) as bar:
        task = bar.add_task("message packages", total=1.0, visible=console.is_terminal)
        shown = ""

        def show(part: float, what: str) -> None:
            nonlocal shown
            text = f"building message packages, only this once: {what}"
            if console.is_terminal:
                bar.update(task, completed=part, description=text)
            elif text != shown:  # in a log, a line for each package
                typer.echo(f"{text} ({part:.0%})", err=True)
            shown = text

        packages = message_packages.ensure(show)
    return packages


async def serve_dashboard(options: "DriverOptions") -> None:
    """Run the node dashboard_client alone until cancelled. Its services appear when the robot answers, as officially.

    Without the parameter ``autoconnect`` they appear immediately, and ``~/connect`` connects.
    """
    from client.driver import DriverConfig
    from client.ros2.dashboard import DashboardNode
    from client.ros2.host import NodeHost, in_thread

    config = DriverConfig(host=options.robot_ip, **options.driver_options)
    if "autoconnect:=false" not in options.ros_arguments:
        await _dashboard_answers(config)
    async with NodeHost(
        domain=options.domain, namespace=options.namespace, ros_arguments=options.ros_arguments
    ) as host:
        node = await in_thread(DashboardNode, host, config)
        try:
            await asyncio.Event().wait()
        finally:
            await in_thread(node.close)


async def _dashboard_answers(config: "DriverConfig") -> None:
    """Wait until the dashboard, or the Robot API of PolyScope X, can be connected to."""
    said, ports = False, config.robot_ports
    while True:
        try:
            async with DashboardClient(config.host, ports["dashboard"], robot_api_port=ports["robot api"]):
                return
        except URError as error:
            if not said:
                typer.echo(f"{error}; trying again", err=True)
            said = True
            await asyncio.sleep(_RETRY_S)


async def serve(options: "DriverOptions", link: "socket.socket") -> None:
    """Run the driver until cancelled. link: to the process of the control loop; if that ends, raises Ros2Error."""
    from client.ros2.driver import Ros2Driver

    async with Ros2Driver(options, link) as driver:
        if text := await driver.waiting():
            typer.echo(text, err=True)
        typer.echo(await driver.ready(), err=True)
        await driver.ended()
