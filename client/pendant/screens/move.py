"""Move: the arm in 3D, buttons that move it while they are held, targets, freedrive, poses."""

from nicegui import ui

from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Page
from client.pendant.screens.move_jog import JogPanels, MoveSettings
from client.pendant.screens.move_plan import PlannedMove
from client.pendant.screens.move_target import joint_target, pose_target, saved_poses
from client.pendant.situation import Action
from client.pendant.station import Station


def build(page: Page) -> None:
    settings = MoveSettings(page)
    jog = JogPanels(page, settings)
    planned = PlannedMove(page, settings)
    with ui.element("div").classes("move") as screen:
        with ui.element("div").classes("move-side"):
            jog.tool()
            jog.speed_and_freedrive()
            _stop_button(page)
        with ui.element("div").classes("move-view panel"):
            scene = arm_scene(page)
            scene.preview = lambda: settings.preview
            planned.draw(scene)
            camera_buttons(page, scene)
            _status_line(page)
        with ui.element("div").classes("move-side"):
            jog.joints()
            _targets(page, settings, planned)
    page.live.bind(screen, "state", lambda station: "free" if station.situation.permits(Action.MOVE) else "blocked")


def _targets(page: Page, settings: MoveSettings, planned: PlannedMove) -> None:
    with ui.card().classes("panel move-targets"):
        with ui.tabs().props("dense no-caps align=justify inline-label").classes("move-tabs") as tabs:
            names = {"joints": "Joint angles", "pose": "TCP pose", "poses": "Poses", "plan": "Plan"}
            for name, title in names.items():
                ui.tab(name, title).props(f"data-testid=target-{name}")
        with ui.tab_panels(tabs, value="joints", animated=False).classes("move-tab-panels"):
            with ui.tab_panel("joints"):
                joint_target(page, settings)
            with ui.tab_panel("pose"):
                pose_target(page, settings)
            with ui.tab_panel("poses"):
                saved_poses(page, settings)
            with ui.tab_panel("plan"):
                planned.panel()
        tabs.on_value_change(lambda change: planned.set_visible(change.value == "plan"))


def _stop_button(page: Page) -> None:
    """A button that stops the arm: a motion from here, or a program."""

    async def stop() -> None:
        station = page.station
        await station.mover.stop()
        if not station.mover.in_control and station.situation.permits(Action.STOP):
            await page.stop()

    button = page.needs_robot(ui.button("Stop", icon="back_hand", color=None, on_click=page.handler(stop)))
    button.classes("move-stop").props("unelevated no-caps data-testid=stop-moving")
    page.live.bind(button, "state", _stop_state)


def _status_line(page: Page) -> None:
    """The present motion, and why it is slow or why none is permitted."""
    with ui.element("div").classes("move-status"):
        chip = page.live.text(lambda station: station.mover.activity, "chip move-activity")
        chip.props("data-testid=activity")
        page.live.bind(chip, "state", lambda station: "on" if station.mover.activity else "off")
        slowed = page.live.text(lambda s: s.mover.slowed or s.situation.refusal(Action.MOVE), "move-slowed")
        slowed.props("data-testid=slowed")


def _stop_state(station: Station) -> str:
    return "moving" if station.mover.activity or station.situation.permits(Action.PAUSE) else "rest"
