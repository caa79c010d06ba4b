"""Answers of the gripper software on the controller to its clients."""

from typing import Final

from emulator.devices.robotiq import SLAVE_ID, Gripper
from urproto.robotiq import ACK, NACK, UNKNOWN, Get, Request, Set, encode_value

_SLAVE: Final = "SID"
_SLAVE_IDS: Final = range(1, 248)  # Modbus
# the maker's programs read 17 bytes and search for the number after the bracket; the blanks are a guess
_SLAVE_LIST: Final = f"[{SLAVE_ID}]".ljust(17)


class GripperSession:
    """One client; each connection chooses its gripper by slave number."""

    def __init__(self) -> None:
        self._slave = SLAVE_ID

    def answer(self, gripper: Gripper, requests: tuple[Request, ...]) -> bytes:
        """The answers in order, in one piece: clients read the answers to joint requests with a single call."""
        return b"".join(self._answer(gripper, request) for request in requests)

    def _answer(self, gripper: Gripper, request: Request) -> bytes:
        if isinstance(request, Get):
            return encode_value(request, self._value(gripper, request.name))
        if isinstance(request, Set) and all(self._accepts(gripper, name, value) for name, value in request.values):
            for name, value in request.values:
                self._set(gripper, name, value)
            return ACK
        return NACK

    def _value(self, gripper: Gripper, name: str) -> str:
        if name == _SLAVE:
            return _SLAVE_LIST if gripper.powered else "[]".ljust(len(_SLAVE_LIST))
        return (gripper.get(name) if self._slave == SLAVE_ID else None) or UNKNOWN

    def _accepts(self, gripper: Gripper, name: str, value: int) -> bool:
        return value in _SLAVE_IDS if name == _SLAVE else gripper.accepts(name, value)

    def _set(self, gripper: Gripper, name: str, value: int) -> None:
        if name == _SLAVE:
            self._slave = value
        elif self._slave == SLAVE_ID:
            gripper.set(name, value)
