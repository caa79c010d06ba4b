"""How an emulator's time goes by: its speed, pause, steps."""

from collections.abc import Awaitable, Callable
from math import log10
from typing import Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.station import Station

__all__ = ["time_panel"]

_SLOWEST, _FASTEST = 0.1, 10.0
_STEPS: Final = (1, 10, 125)


def time_panel(page: Page) -> None:
    """One line: the clock, pause or resume, steps, and a slider of speeds."""
    live, behind = page.live, page.station.behind
    with ui.card().classes("panel sim-time"):
        ui.icon("schedule").classes("sim-time-icon")
        live.text(_clock, "sim-clock").props("data-testid=sim-clock")
        live.bind(live.text(_pace, "sim-pace").props("data-testid=sim-pace"), "state", _pace_state)
        pause = ui.button("Pause", icon="pause", on_click=page.doing(lambda: behind.change("pause_time")))
        pause.props("unelevated dense data-testid=time-pause").classes("sim-button")
        resume = ui.button("Resume", icon="play_arrow", on_click=page.doing(lambda: behind.change("resume_time")))
        resume.props("unelevated dense color=positive data-testid=time-resume").classes("sim-button")
        page.show_if(pause, lambda station: not _paused(station))
        page.show_if(resume, _paused)
        with ui.button_group().props("flat").classes("sim-steps"):
            for count in _STEPS:
                _step_button(page, count)
        ui.space()
        _speed(page)


def _step_button(page: Page, count: int) -> None:
    button = ui.button(f"+{count}", on_click=page.doing(lambda: page.station.behind.change("step", periods=count)))
    button.props(f"outline dense data-testid=time-step-{count}").classes("sim-button")
    button.tooltip(f"{count} control period{'s' if count > 1 else ''}")
    page.live.effect(_paused, button.set_enabled)


def _speed(page: Page) -> None:
    behind = page.station.behind
    slider = ui.slider(min=log10(_SLOWEST), max=log10(_FASTEST), step=0.01).props("dense data-testid=time-speed")
    slider.classes("sim-speed").props('markers=1 aria-label="Speed of time"')

    async def set_speed() -> None:
        await page.attempt(lambda: behind.change("set_speed", speed=round(10.0**slider.value, 2)))

    slider.on("change", set_speed)
    live = page.live
    live.effect(_speed_of, lambda speed: slider.set_value(log10(min(_FASTEST, max(_SLOWEST, speed or _FASTEST)))))
    for text, speed, mark in (("0.1×", 0.1, "slow"), ("1×", 1.0, "real"), ("10×", 10.0, "fast"), ("Max", 0.0, "max")):
        button = ui.button(text, on_click=_setter(page, speed)).props(f"flat dense no-caps data-testid=time-{mark}")
        button.classes("sim-button")
        if not speed:
            button.tooltip("As fast as it goes")


def _setter(page: Page, speed: float) -> Callable[[], Awaitable[None]]:
    return page.doing(lambda: page.station.behind.change("set_speed", speed=speed))


def _paused(station: Station) -> bool:
    return bool(station.behind.time.get("paused", False))


def _speed_of(station: Station) -> float:
    return float(station.behind.time.get("speed", 1.0))


def _pace(station: Station) -> str:
    return station.behind.pace or "real time"


def _pace_state(station: Station) -> str:
    return "paused" if _paused(station) else "real" if _speed_of(station) == 1.0 else "other"


def _clock(station: Station) -> str:
    time = station.behind.time
    paused = _paused(station) or not station.connected
    seconds = float(time.get("time_s", 0.0) if paused else station.values.get("timestamp", 0.0))
    return f"{seconds:.3f} s" if paused else f"{seconds:.1f} s"
