"""``ur-client ros2``: the nodes of the official ROS 2 driver for a robot, on rclpy."""

import asyncio
import sys
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from client.commands.cameras import CameraNames, CameraOptions, CameraPort, CameraRate
from client.commands.control import ControllersOption, Headless, MakeReady, announce, controllers_file, run
from client.commands.following import PortOffset, RobotIP
from client.driver.config import ROBOT_PORTS
from client.driver.scheduling import real_time
from urproto.ports import CAMERA_PORT

if TYPE_CHECKING:
    from client.ros2.driver import DriverOptions

_CONTROLLER = "scaled_joint_trajectory_controller"
_CAMERA_HZ = 10.0
_SWITCH_INTERVAL_S = 0.0005  # between threads: with Python's 5 ms, a busy callback would delay a setpoint


def ros2_command(
    ros_arguments: Annotated[
        list[str] | None,
        typer.Argument(metavar="[-- ROS_ARGUMENTS]", help="Arguments for ROS, such as -r or --params-file."),
    ] = None,
    controller: Annotated[
        str, typer.Option(help="Controller to activate once the arm can be moved; empty for none.")
    ] = _CONTROLLER,
    domain: Annotated[
        int | None, typer.Option("--domain", min=0, max=232, help="ROS domain, instead of ROS_DOMAIN_ID.")
    ] = None,
    namespace: Annotated[str, typer.Option(help="Namespace of all nodes: left gives /left/joint_states.")] = "",
    tf_prefix: Annotated[
        str, typer.Option("--tf-prefix", help="Prefix for the names of joints, frames and interfaces, such as left_.")
    ] = "",
    headless: Headless = True,
    setup: Annotated[
        bool, typer.Option("--setup", help="Build the message packages missing from this ROS 2 installation, and exit.")
    ] = False,
    camera: CameraNames = None,
    camera_rate: CameraRate = _CAMERA_HZ,
    camera_port: CameraPort = None,
    controllers: ControllersOption = None,
    make_ready: MakeReady = False,
    robot_ip: RobotIP = "127.0.0.1",
    port_offset: PortOffset = 0,
) -> None:
    """Run the ROS 2 driver: nodes, topics, services and actions as in ur_robot_driver. See docs/ros2.md."""
    cameras = CameraOptions(robot_ip, camera_port or CAMERA_PORT + port_offset, camera or (), camera_rate)
    prepare()
    if setup:
        return
    from client.ros2.driver import DriverOptions

    options = DriverOptions(
        robot_ip,
        {"robot_ports": {name: port + port_offset for name, port in ROBOT_PORTS.items()}},
        controllers_file(controllers, tf_prefix),
        controller=controller,
        tf_prefix=tf_prefix,
        headless=headless,
        make_ready=make_ready,
        namespace=namespace,
        domain=domain,
        cameras=tuple(cameras.names),
        camera_port=cameras.port,
        camera_hz=cameras.rate_hz,
        ros_arguments=tuple(argument for argument in ros_arguments or () if argument != "--ros-args"),
    )
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    run(serve(options))


def prepare() -> None:
    """Make rclpy and all message packages importable; build those that are missing. Raises Ros2Error."""
    from client.ros2 import message_packages

    if not message_packages.missing():
        return
    with Progress(TextColumn("{task.description}"), BarColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("message packages", total=1.0)

        def show(part: float, what: str) -> None:
            bar.update(task, completed=part, description=f"building message packages, only this once: {what}")

        packages = message_packages.ensure(show)
    if packages.setup_file is not None:
        typer.echo(f"to use the message packages in other programs: . {packages.setup_file}", err=True)


async def serve(options: "DriverOptions") -> None:
    """Run the driver until cancelled."""
    from client.ros2.driver import Ros2Driver

    async with Ros2Driver(options) as driver:
        with real_time("auto"):  # for the event loop alone: the threads of the nodes have been started already
            await announce(driver.running, options)
            await asyncio.Event().wait()
