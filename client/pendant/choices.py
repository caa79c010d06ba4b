"""What a person chooses and a robot has: shown as the robot has it."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, Final

from nicegui.elements.mixins.value_element import ValueElement

from client.errors import ClientError
from client.pendant.page import Page
from client.pendant.station import Station

__all__ = ["NotTakenError", "choice", "happens", "take"]

_SOON_S: Final = 1.5  # guess: states and answers come within a tenth of that


class NotTakenError(ClientError):
    """The robot was told something, did not say no, and did not do it either."""


def choice(
    page: Page,
    element: ValueElement[Any],
    read: Callable[[Station], Any],
    choose: Callable[[Any], Awaitable[Any]],
    what: str,
) -> None:
    """Let an element follow the robot, and the robot what is chosen with it; ``what`` is what to call it."""
    station = page.station

    async def chosen() -> None:
        wanted = element.value
        if not await page.attempt(
            lambda: take(station, lambda: choose(wanted), lambda s: read(s) == wanted, f"{what} {wanted}")
        ):
            element.set_value(read(station))

    element.on("update:model-value", chosen)
    page.live.effect(read, element.set_value)


async def take(
    station: Station, tell: Callable[[], Awaitable[Any]], taken: Callable[[Station], bool], what: str
) -> None:
    """Tell the robot something and wait until it has it. Raises NotTakenError, and what ``tell`` raises."""
    heard = station.log.count
    await tell()
    if not await happens(station, taken):
        said = [event.text for event in station.log.since(heard) if event.severity == "error"]
        reason = f"it says: {'; '.join(said)}" if said else "is it in local control, or without power?"
        raise NotTakenError(f"the robot did not take {what}: {reason}")


async def happens(station: Station, condition: Callable[[Station], bool]) -> bool:
    """Whether it holds soon."""
    try:
        async with asyncio.timeout(_SOON_S):
            while not condition(station):
                await station.next_frame()
    except TimeoutError:
        return False
    return True
