"""Faults of a scene: parts, conveyors and cameras that do not behave as programs expect (``--physics``)."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from emulator.faults.fault import Act, Fault, FaultImpossibleError, Site, Strikes, register, until_ended
from emulator.world.world import Disturbances


def _scene(site: Site) -> Disturbances:
    world = site.controller.world
    found = None if world is None else world.disturbances
    if found is None:
        raise FaultImpossibleError("this robot has no scene with physics: start it with --world and --physics")
    return found


def _check(kind: str, name: str, there: Collection[str]) -> None:
    if name not in there:
        raise FaultImpossibleError(f"there is no {kind} {name!r}: choose from {', '.join(there) or 'none'}")


@dataclass(frozen=True, kw_only=True)
class PartFault(Fault):
    """A fault of a part that moves freely, given by its name in the world file."""

    part: str

    def claims(self, site: Site) -> set[str]:
        return {f"the part {self.part}"}

    def check(self, site: Site) -> None:
        _check("part", self.part, _scene(site).parts)


@register
class MissingPart(PartFault):
    """A part is missing, and a gripper that held it holds nothing.

    When the fault ends, the part is where it was at its beginning, or where it was put since, for example by
    ``reset_world``.
    """

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        try:
            while True:
                scene.take_away(self.part)
                yield
        finally:
            scene.bring_back(self.part)


@register
class SlipperyPart(PartFault):
    """A part has this coefficient of ``friction`` with all it touches, also fingers; suction cups still hold it."""

    friction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        scene.set_friction(self.part, self.friction)
        yield from until_ended(lambda: scene.set_friction(self.part, None))


@register
class JammedConveyor(Fault):
    """A conveyor stands still, whatever the state of its output, and its encoder does not count."""

    conveyor: str

    def claims(self, site: Site) -> set[str]:
        return {f"the conveyor {self.conveyor}"}

    def check(self, site: Site) -> None:
        _check("conveyor", self.conveyor, _scene(site).conveyors)

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        scene.jam(self.conveyor, jammed=True)
        yield from until_ended(lambda: scene.jam(self.conveyor, jammed=False))


@register
class CoveredCamera(Fault):
    """A camera's lens is covered: its images are black, and its distances 0."""

    camera: str

    def claims(self, site: Site) -> set[str]:
        return {f"the camera {self.camera}"}

    def check(self, site: Site) -> None:
        _check("camera", self.camera, _scene(site).cameras)

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        scene.cover(self.camera, covered=True)
        yield from until_ended(lambda: scene.cover(self.camera, covered=False))
