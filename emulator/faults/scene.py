"""Faults of a scene: what its parts, belts and cameras do is not what programs expect (``--physics``)."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from emulator.faults.fault import Act, Fault, FaultImpossible, Site, Strikes, register
from emulator.world.disturbances import Disturbances


def _scene(site: Site) -> Disturbances:
    world = site.controller.world
    found = None if world is None else world.disturbances
    if found is None:
        raise FaultImpossible("nothing around this robot moves: start it with --world and --physics")
    return found


def _check(kind: str, name: str, there: Collection[str]) -> None:
    if name not in there:
        raise FaultImpossible(f"there is no {kind} {name!r}; there are: {', '.join(there) or 'none'}")


@dataclass(frozen=True, kw_only=True)
class PartFault(Fault):
    """Of something that moves freely, by its name in the world file."""

    part: str

    def claims(self, site: Site) -> set[str]:
        return {f"the part {self.part}"}

    def check(self, site: Site) -> None:
        _check("part", self.part, _scene(site).parts)


@register
@dataclass(frozen=True, kw_only=True)
class MissingPart(PartFault):
    """A part is not there, and what held it holds nothing.

    In the end it is where it was at first, or where it was put meanwhile, say by ``reset_world``.
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
@dataclass(frozen=True, kw_only=True)
class SlipperyPart(PartFault):
    """A part slides with this coefficient of ``friction`` on all it touches, fingers too; suction cups hold it."""

    friction: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.01

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        scene.set_friction(self.part, self.friction)
        try:
            while True:
                yield
        finally:
            scene.set_friction(self.part, None)


@register
@dataclass(frozen=True, kw_only=True)
class JammedConveyor(Fault):
    """A belt stands, whatever its output says, and its encoder does not count."""

    conveyor: str

    def claims(self, site: Site) -> set[str]:
        return {f"the conveyor {self.conveyor}"}

    def check(self, site: Site) -> None:
        _check("conveyor", self.conveyor, _scene(site).conveyors)

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        scene.jam(self.conveyor, jammed=True)
        try:
            while True:
                yield
        finally:
            scene.jam(self.conveyor, jammed=False)


@register
@dataclass(frozen=True, kw_only=True)
class CoveredCamera(Fault):
    """Something is right before a camera's lens: its pictures are black, its distances 0."""

    camera: str

    def claims(self, site: Site) -> set[str]:
        return {f"the camera {self.camera}"}

    def check(self, site: Site) -> None:
        _check("camera", self.camera, _scene(site).cameras)

    def act(self, site: Site, strikes: Strikes) -> Act:
        scene = _scene(site)
        scene.cover(self.camera, covered=True)
        try:
            while True:
                yield
        finally:
            scene.cover(self.camera, covered=False)
