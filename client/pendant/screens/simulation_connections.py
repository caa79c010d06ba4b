"""Who is connected to which port, told every second."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from nicegui import ui

from client.pendant.page import Page
from client.pendant.station import Station

__all__ = ["connections_tab"]

_Connections = Mapping[str, Sequence[str]]


def connections_tab(page: Page) -> None:
    """Put it there."""
    with ui.element("div").classes("sim-rows sim-connections").props("data-testid=connections") as rows:
        pass

    def show(connections: _Connections | None) -> None:
        rows.clear()
        with rows:
            for title in ("Port", "", "Clients"):
                ui.label(title).classes("init-th")
            for name, peers in (connections or {}).items():
                _row(page, name, peers)

    page.live.effect(_connections, show)


def _connections(station: Station) -> Any:
    return station.behind.watch("connections").value if station.behind.available else None


def _row(page: Page, name: str, peers: Sequence[str]) -> None:
    behind = page.station.behind
    ui.label(name).classes("sim-port")
    ui.label(str(behind.catalogue.get("ports", {}).get(name, ""))).classes("sim-port-number")
    with ui.element("div").classes("sim-peers"):
        for peer in peers:
            with ui.element("span").classes("sim-peer"):
                ui.label(peer)
                if name != "control":
                    drop = partial(behind.change, "inject_fault", kind="drop_connection", port=name, peer=peer)
                    ui.button(icon="link_off", on_click=page.doing(drop)).props(
                        f'flat round dense size=sm aria-label="Drop {peer}" title="End this connection"'
                    )
        if not peers:
            ui.label("–").classes("init-th")
