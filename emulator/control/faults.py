"""Verbs about faults."""

from typing import Any

from emulator.control.base import ControlBase
from emulator.control.verbs import BadArguments, NotPossible, verb
from emulator.faults.catalogue import kinds, make_fault
from emulator.faults.fault import FaultError, FaultImpossible
from emulator.faults.injector import FaultInjector

__all__ = ["FaultVerbs"]


class FaultVerbs(ControlBase):
    """Verbs about what goes wrong."""

    _faults: FaultInjector

    @verb
    def inject_fault(self, kind: str, **arguments: Any) -> int:
        """Let a fault happen; its id. ``fault_kinds`` tells the kinds and their arguments.

        For example ``drop_connection port=rtde after=5``, ``delay port=rtde delay_s=0.05 lasting=10``.
        """
        try:
            return self._faults.inject(make_fault(kind, arguments))
        except FaultError as error:
            raise BadArguments(str(error)) from error
        except FaultImpossible as error:
            raise NotPossible(f"{kind}: {error}") from error

    @verb
    def clear_fault(self, fault_id: int) -> None:
        """End a fault, or take back one that waits."""
        if not self._faults.clear(fault_id):
            raise NotPossible(f"there is no fault {fault_id} that waits or is in force")

    @verb
    def clear_faults(self) -> None:
        """End every fault."""
        self._faults.clear_all()

    @verb
    def faults(self) -> list[dict[str, Any]]:
        """Faults that wait, are in force or are over (the last hundred), and how often each struck."""
        return self._faults.listing()

    @verb
    def fault_kinds(self) -> list[dict[str, Any]]:
        """What faults there are: kind, text, on what occasion one strikes, arguments with types and defaults."""
        return kinds()
