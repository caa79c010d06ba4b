"""Network services that robots of this kind have and the emulator does not: nothing listens on their ports."""

from dataclasses import dataclass
from typing import Final

__all__ = ["NOT_EMULATED", "POLYSCOPE_X", "MissingService"]


@dataclass(frozen=True, slots=True)
class MissingService:
    """A service, where a robot has it, why it is not here and what does the same here."""

    name: str
    ports: str
    reason: str
    instead: str


POLYSCOPE_X: Final = MissingService(
    "Robot API of PolyScope X",
    "HTTP 80, /universal-robots/robot-api",
    "PolyScope X (10.x) is another product; 3.x and 5.x never had it",
    "the dashboard server, which 10.x no longer has",
)

NOT_EMULATED: Final = (
    POLYSCOPE_X,
    MissingService("EtherNet/IP adapter", "TCP 44818, UDP 2222", "a fieldbus", "its registers by RTDE or Modbus"),
    MissingService(
        "PROFINET IO device, PROFIsafe",
        "UDP 34964 and Ethernet frames",
        "a fieldbus",
        "its registers by RTDE or Modbus",
    ),
    MissingService("SSH and SFTP", "TCP 22", "there is no Linux to log in to", "the folder of --programs"),
    MissingService(
        "Screen of the teach pendant",
        "VNC 5900, HTTP 6080 (simulators)",
        "PolyScope's screen is the vendor's",
        "the dashboard server and the script ports",
    ),
)
