"""The light ring in the base."""

from emulator.builtins.host import ProgramHost
from emulator.io.signals import BaseLight
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.values import Int

LIBRARY = Library("baselight", host=True)


@LIBRARY.builtin(cb3=None, e="5.20", note="UR20 and UR30 only; other arms log the call and ignore it", work=60)
def set_baselight_off(host: ProgramHost) -> None:
    """Switch the base light off."""
    _light(host, BaseLight("off"))


@LIBRARY.builtin(
    cb3=None, e="5.20", status="partial", note="stored as the light's mode; the colour is not computed", work=60
)
def set_baselight_iec(host: ProgramHost) -> None:
    """Show the state of the arm on the base light, in the colours of IEC 60204-1."""
    _light(host, BaseLight("iec"))


@LIBRARY.builtin(cb3=None, e="5.20", note="UR20 and UR30 only; other arms log the call and ignore it", work=60)
def set_baselight_solid(host: ProgramHost, r: Int, g: Int, b: Int) -> None:
    """Show one colour on the base light: red, green and blue, each 0 to 255."""
    if not all(0 <= part <= 255 for part in (r, g, b)):
        raise RuntimeFault(f"set_baselight_solid: r, g and b must be 0 to 255, not {r}, {g}, {b}")
    _light(host, BaseLight("solid", (r, g, b)))


def _light(host: ProgramHost, light: BaseLight) -> None:
    model = host.machine.model
    if model.base_light:
        host.machine.base_light = light
    else:
        host.machine.messages.note(f"{model.title} has no base light: the call has no effect")
