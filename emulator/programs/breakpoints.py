"""Where the main program is to be paused: breakpoints at nodes, and single steps from node to node.

Nodes are known by their labels (``$ 4 "Wait"``). A thread that reaches a label asks first; one that is held asks again
when the program is resumed, and then goes on.
"""

from collections.abc import Callable, Iterable
from typing import Final

from urscript.runtime import ScriptThread

_BEHIND: Final = "breakAfter"  # PolyScope's word at waypoints: the pause comes when the arm is there
_NOWHERE: Final = "noBreak"  # and at the via point of an arc, at which nothing can pause
_BODY: Final = 0  # handle of the program body
_BRANCHES: Final = ("Thread_if_", "Thread_while_")  # the main program, while an expression is checked continuously


class Breakpoints:
    """numbers: of the nodes. armed: a label has something to ask at all. pause: told why, when a thread is held."""

    def __init__(self, pause: Callable[[str], object]) -> None:
        self._pause = pause
        self._stepping = False
        self._held = set[int]()  # threads by their handle, which ask again
        self._behind = dict[int, int]()  # a thread, and the node whose end it has not reached
        self.numbers: frozenset[int] = frozenset()
        self.armed = False

    def set(self, numbers: Iterable[int]) -> None:
        """These instead of those before."""
        self.numbers = frozenset(numbers)
        self._behind = {thread: number for thread, number in self._behind.items() if number in self.numbers}
        self._arm()

    def step(self) -> None:
        """Pause at the next node of the main program."""
        self._stepping = True
        self._arm()

    def program_started(self) -> None:
        """Threads are others than before."""
        self._held.clear()
        self._behind.clear()
        self._arm()

    def program_stopped(self) -> None:
        """A step was for that program."""
        self._stepping = False
        self.program_started()

    def hold(self, number: int, option: str, thread: ScriptThread) -> bool:
        """Whether a thread at this label has to wait, which pauses the program."""
        if thread.id in self._held:
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
