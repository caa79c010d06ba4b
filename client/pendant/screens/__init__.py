"""The screens of the pendant, named as in PolyScope: one module and one entry here for each."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from client.pendant.page import Page
from client.pendant.screens import (
    cameras,
    controllers,
    graph,
    initialize,
    installation,
    io,
    log,
    move,
    program,
    run,
    simulation,
)
from client.pendant.station import Station

__all__ = ["SCREENS", "Screen"]


@dataclass(frozen=True, slots=True)
class Screen:
    """A screen. name: also the path of its address. build: adds it to a page. shown: whether a robot has it."""

    name: str
    title: str
    icon: str
    build: Callable[[Page], None]
    shown: Callable[[Station], bool] = lambda station: True


SCREENS: Final = (
    Screen("initialize", "Initialize", "power_settings_new", initialize.build),
    Screen("run", "Run", "play_circle", run.build),
    Screen("program", "Program", "account_tree", program.build),
    Screen("move", "Move", "open_with", move.build),
    Screen("io", "I/O", "settings_input_component", io.build),
    Screen("log", "Log", "list_alt", log.build),
    Screen("graph", "Graph", "show_chart", graph.build),
    Screen("controllers", "Controllers", "linear_scale", controllers.build),
    Screen("installation", "Installation", "tune", installation.build),
    Screen("cameras", "Cameras", "videocam", cameras.build, lambda station: bool(station.cameras.available)),
    Screen("simulation", "Simulation", "science", simulation.build, lambda station: station.emulator.is_present),
)
