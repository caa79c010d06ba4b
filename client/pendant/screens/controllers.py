"""Controllers: those of a running controller manager, buttons that change them, and sliders that move the arm."""

from collections.abc import Callable
from functools import partial
from math import degrees, pi, radians
from typing import Any, Final

from nicegui import ui

from client.controllers.controller import interface_summary
from client.pendant.manager_link import Controllers, ControlPanel, trajectory_controllers
from client.pendant.page import Page
from client.pendant.station import Station
from urproto.joints import JOINT_TITLES

_MAX_RANGE: Final = 2.0 * pi  # of a slider for a joint that has no limit [rad]
_ACTIONS: Final = {  # state -> possible actions: title, icon, request
    "unloaded": (("Load", "file_download", "load_controller"),),
    "unconfigured": (("Configure", "build", "configure_controller"), ("Unload", "delete", "unload_controller")),
    "inactive": (("Activate", "play_arrow", ""), ("Unload", "delete", "unload_controller")),
    "active": (("Deactivate", "stop", ""),),
}


def build(page: Page) -> None:
    with ui.element("div").classes("controllers"):
        _List(page)
        _Sliders(page)


class _List:
    """All controllers, one per row; the selected ones are switched together."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._ticked: set[str] = set()
        with page.panel("Controller manager", "controllers-panel"):
            problem = page.live.text(lambda station: station.manager.problem, "controllers-problem")
            problem.props("role=status data-testid=manager-problem")
            self._rows = ui.element("div").classes("controllers-rows").props('role=list aria-label="Controllers"')
            with ui.row().classes("controllers-tools"):
                switch = ui.button("Switch ticked", icon="swap_vert", on_click=page.handler(self._switch))
                switch.props("no-caps unelevated data-testid=controllers-switch")
                switch.tooltip("Deactivate the active ones and activate the inactive ones, in one control cycle")
            page.show_if(switch, lambda station: bool(station.manager.controllers))
        page.live.effect(lambda station: station.manager.controllers, self._show)

    def _show(self, controllers: Controllers) -> None:
        self._ticked &= {controller["name"] for controller in controllers}
        self._rows.clear()
        with self._rows:
            for controller in controllers:
                self._row(controller)

    def _row(self, controller: dict[str, Any]) -> None:
        name, state = controller["name"], controller["state"]
        with ui.element("div").classes("controllers-row").props(f"role=listitem data-testid=controller-{name}"):
            if state in ("active", "inactive"):
                tick = ui.checkbox(value=name in self._ticked, on_change=partial(self._tick, name))
                tick.props(f'dense aria-label="Tick {name}"')
            else:
                ui.element("span")
            with ui.element("div").classes("controllers-name"):
                ui.label(name)
                ui.label(controller["type"]).classes("controllers-type")
                if claims := controller.get("claimed_interfaces"):
                    ui.label(f"claims {interface_summary(claims)}").classes("controllers-type").tooltip(
                        "\n".join(claims)
                    )
            ui.label(state).classes("chip").props(f"data-state={'good' if state == 'active' else 'off'}")
            with ui.element("div").classes("controllers-actions"):
                for title, icon, request in _ACTIONS.get(state, ()):
                    button = ui.button(title, icon=icon, color=None, on_click=self._action(name, state, request))
                    button.props(f'no-caps dense unelevated aria-label="{title} {name}"')
                    button.props(f"data-testid={title.lower()}-{name}")

    def _action(self, name: str, state: str, request: str) -> Callable[[], Any]:
        link = self._page.station.manager
        if request:
            return self._page.handler(lambda: link.change(request, name=name))
        action = "deactivate" if state == "active" else "activate"
        return self._page.handler(lambda: link.change("switch_controller", **{action: [name]}))

    def _tick(self, name: str, change: Any) -> None:
        (self._ticked.add if change.value else self._ticked.discard)(name)

    async def _switch(self) -> None:
        states = {controller["name"]: controller["state"] for controller in self._page.station.manager.controllers}
        chosen = {
            state: [name for name in self._ticked if states.get(name) == state] for state in ("active", "inactive")
        }
        if not any(chosen.values()):
            raise ValueError("Tick the controllers to switch first.")
        self._ticked.clear()
        link = self._page.station.manager
        await link.change("switch_controller", activate=chosen["inactive"], deactivate=chosen["active"])


class _Sliders:
    """The control panel: see `client.pendant.manager_link.ControlPanel`."""

    def __init__(self, page: Page) -> None:
        self._page = page
        station = page.station
        self._panel = panel = ControlPanel(station.manager, lambda: _arm(station))
        panel.on_end.append(self._on_end)
        page.on_close.append(panel.disable)
        page.live.on_message("sliders", self._set_targets)
        page.live.on_show.append(lambda screen: None if screen == "controllers" else panel.disable())
        with page.panel("Joint trajectory", "sliders-panel"):
            with ui.row().classes("sliders-head"):
                self._choice = ui.select([], label="Controller", on_change=lambda change: self._select(change.value))
                self._choice.props("dense outlined data-testid=sliders-controller").classes("sliders-choice")
                self._switch = ui.switch("The arm follows").props("data-testid=sliders-enable")
                self._switch.on("update:model-value", self._enable)
            with ui.element("div").classes("sliders").props("data-testid=sliders") as grid:
                for i, title in enumerate(JOINT_TITLES):
                    ui.label(title).classes("jog-name")
                    step = 'min=-360 max=360 step="any" disabled'
                    ui.element("input").props(f'type=range {step} aria-label="{title}" data-testid=slider-{i}')
                    number = ui.element("input").props(f'type=number {step} aria-label="{title} in degrees"')
                    number.props(f"data-testid=slider-number-{i}")
                    ui.label("°").classes("jog-unit")
            page.live.bind(grid, "sliders", self._values)
            with ui.row().classes("sliders-speed"):
                ui.icon("speed")
                ui.label("Speed scaling")
                speed = ui.slider(min=1, max=100, value=100.0 * panel.scaling, on_change=self._set_scaling)
                speed.props('dense aria-label="Speed scaling" data-testid=sliders-speed')
                self._percent = ui.label(f"{100.0 * panel.scaling:.0f} %").classes("live")
            page.live.text(self._hint, "sliders-hint").props("role=status")
        page.live.effect(lambda s: trajectory_controllers(s.manager.controllers), self._set_choices)

    def _set_choices(self, names: list[str]) -> None:
        chosen = self._panel.controller
        if chosen not in names:
            chosen = names[0] if names else ""
        self._choice.set_options(names, value=chosen or None)
        self._select(chosen)
        self._switch.set_enabled(bool(names))

    def _select(self, name: str | None) -> None:
        self._panel.select_controller(name or "")

    def _set_scaling(self, change: Any) -> None:
        self._panel.scaling = change.value / 100.0
        self._percent.set_text(f"{change.value:.0f} %")

    async def _enable(self) -> None:
        if not self._switch.value:
            self._panel.disable()
            return
        enabled = False
        if await self._page.confirm_move():
            enabled = await self._page.attempt(self._start)
        self._switch.set_value(enabled)

    def _start(self) -> None:
        self._panel.enable()
        self._page.station.notify_pages()

    def _on_end(self, reason: str) -> None:
        self._switch.set_value(False)
        self._page.station.notify_pages()
        if reason:
            self._page.show_error(f"The arm no longer follows the sliders: {reason}")

    def _set_targets(self, angles: Any) -> None:
        """Set the slider positions of a browser [deg]. Raises ValueError if invalid, which ends its connection."""
        try:
            self._panel.set_targets([radians(angle) for angle in angles] if isinstance(angles, list) else angles)
        except (TypeError, OverflowError) as error:
            raise ValueError(str(error)) from None

    def _values(self, station: Station) -> Any:
        """Whether the arm follows; positions and limits of the sliders [deg]."""
        arm = _arm(station)
        if arm is None:
            return [False, [0.0] * len(JOINT_TITLES), None, None]
        lows, highs = (
            [round(degrees(min(max(q, -_MAX_RANGE), _MAX_RANGE)), 2) for q in ends] for ends in arm[1].position_limits
        )
        if self._panel.enabled:
            return [True, None, lows, highs]
        return [False, [round(degrees(q), 2) for q in arm[0]], lows, highs]

    def _hint(self, station: Station) -> str:
        if station.manager.problem:
            return ""
        if not trajectory_controllers(station.manager.controllers):
            return "Activate a joint trajectory controller to move the arm with the sliders."
        return "" if self._panel.enabled else "The sliders show the position of the arm."


def _arm(station: Station) -> Any:
    """Joint angles and model; None while unknown."""
    return (station.values["actual_q"], station.model) if station.model and "actual_q" in station.values else None
