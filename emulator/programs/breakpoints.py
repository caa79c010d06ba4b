"""Breakpoints at nodes of the main program, and single steps from node to node.

Nodes are identified by their labels (``$ 4 "Wait"``). Every thread checks for a breakpoint when it reaches a label; a
held thread checks again when the program is resumed, and then continues.
"""

from collections.abc import Callable, Iterable
from typing import Final

from urscript.runtime import ScriptThread

_BEHIND: Final = "breakAfter"  # PolyScope's option at waypoints: the program pauses when the arm has arrived
_NOWHERE: Final = "noBreak"  # PolyScope's option at the via point of an arc, where no pause is possible
_BODY: Final = 0  # handle of the program body
_BRANCHES: Final = ("Thread_if_", "Thread_while_")  # the main program while an expression is checked continuously


class Breakpoints:
    """Breakpoints. numbers: of the nodes. armed: whether labels need checking.

    pause: called with the reason. paused: whether the program is paused, or slowing down together with the arm.
    """

    def __init__(self, pause: Callable[[str], object], paused: Callable[[], bool]) -> None:
        self._pause, self._paused = pause, paused
        self._stepping = False
        self._held = set[int]()  # handles of held threads, which check again
        self._behind = dict[int, int]()  # per thread, the node whose end it has not reached
        self.numbers: frozenset[int] = frozenset()
        self.armed = False

    def set(self, numbers: Iterable[int]) -> None:
        self.numbers = frozenset(numbers)
        self._behind = {thread: number for thread, number in self._behind.items() if number in self.numbers}
        self._arm()

    def step(self) -> None:
        """Pause at the next node of the main program."""
        self._stepping = True
        self._arm()

    def program_started(self) -> None:
        """Reset the state of threads: a new program starts."""
        self._held.clear()
        self._behind.clear()
        self._arm()

    def program_stopped(self) -> None:
        """Cancel a single step, which was for the program that has ended."""
        self._stepping = False
        self.program_started()

    def hold(self, number: int, option: str, thread: ScriptThread) -> bool:
        """Whether a thread at this label has to wait; if so, pause the program."""
        if thread.id in self._held:
            if self._paused():
                return True
            self._held.discard(thread.id)
            self._note_behind(number, option, thread)
            self._arm()
            return False
        reached = self._behind.pop(thread.id, None)
        step = self._stepping and option != _NOWHERE and _is_main(thread)
        if reached is None and not step and (option or number not in self.numbers):
            self._note_behind(number, option, thread)
            return False
        self._stepping = False
        self._held.add(thread.id)
        self._pause(f"step: node {number}" if step else f"breakpoint: node {number if reached is None else reached}")
        return True

    def _note_behind(self, number: int, option: str, thread: ScriptThread) -> None:
        if option == _BEHIND and number in self.numbers:
            self._behind[thread.id] = number

    def _arm(self) -> None:
        self.armed = bool(self.numbers or self._stepping or self._held or self._behind)


def _is_main(thread: ScriptThread) -> bool:
    return thread.id == _BODY or thread.name.removeprefix("t_").startswith(_BRANCHES)
