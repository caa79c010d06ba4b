"""The control API of an emulator, which a real robot does not have."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final

import httpx

from client.pendant.dialogues import Dialogues
from client.pendant.polling import Poller
from urproto.controlapi import LIST_VERBS, ControlProtocol, NoAccessError
from urproto.errors import URError

POLL_PERIOD_S: Final = 0.5  # while a page is open
_WATCH_PERIOD_S: Final = 1.0
_CATALOGUE: Final = ("describe", "fault_kinds", "ports", "safety_causes")
_TIME_VERBS: Final = ("set_speed", "pause_time", "resume_time", "step")
_MAX_MISSES: Final = 3  # consecutive ones; then the emulator counts as gone (guess)


class EmulatorControl:
    """Verbs of an emulator's control API (docs/reference/control_verbs.md).

    available: the API answers, so this is not a real robot. port: 0 for none. token: the token that the emulator
    expects. locked: the emulator expects another token. time: the result of the verb of this name, empty before the
    first. catalogue: results of verbs that do not change. on_change: called when something to show has changed. wait:
    waits between two queries of ``follow``.
    """

    def __init__(
        self,
        host: str,
        port: int,
        token: str,
        on_change: Callable[[], None],
        wait: Callable[[], Awaitable[None]],
    ) -> None:
        self._port = port
        self._protocol = ControlProtocol(host, port, token)
        self._http = httpx.AsyncClient(base_url=f"http://{host}:{port}", timeout=5.0, trust_env=False)
        self._on_change = on_change
        self._wait = wait
        self._pollers: dict[tuple[str, str], Poller[Any]] = {}
        self.available = False
        self.locked = False
        self.verbs: frozenset[str] = frozenset()
        self.catalogue: Mapping[str, Any] = {}
        self.time: Mapping[str, Any] = {}

    async def close(self) -> None:
        for poller in self._pollers.values():
            await poller.close()
        await self._http.aclose()

    def watch(self, verb: str, **arguments: str) -> Poller[Any]:
        """The result of a read-only verb, queried every second while a page shows it."""
        key = (verb, repr(sorted(arguments.items())))
        if key not in self._pollers:
            self._pollers[key] = Poller(lambda: self.call(verb, **arguments), _WATCH_PERIOD_S, self._on_change)
        return self._pollers[key]

    def read(self, verb: str) -> Any:
        """The result of ``watch``; None without an emulator, or before its first answer."""
        return self.watch(verb).value if self.available else None

    async def change(self, verb: str, **arguments: Any) -> Any:
        """Like ``call``, for a verb that changes watched results, which are queried again immediately."""
        try:
            result = await self.call(verb, **arguments)
            if verb in _TIME_VERBS:
                await self.update_time()
            return result
        finally:
            for poller in self._pollers.values():
                poller.refresh()

    @property
    def pace(self) -> str:
        """How time passes if it is not in real time, "" if it is."""
        if self.time.get("paused", False):
            return "time paused"
        speed = self.time.get("speed", 1.0)
        return "" if speed == 1.0 else f"time {speed:g}×" if speed else "time at its fastest"

    @property
    def is_present(self) -> bool:
        """Whether there is an emulator, even if it rejects this pendant's token."""
        return self.available or self.locked

    async def update_time(self) -> None:
        """Query ``time``. Raises URError."""
        before, self.time = self.time, await self.call("time")
        names = ("paused", "speed", "time_s") if self.time["paused"] else ("paused", "speed")
        if any(before.get(name) != self.time[name] for name in names):
            self._on_change()

    async def is_time_paused(self) -> bool:
        """Whether time is paused, which explains missing states."""
        try:
            await self.update_time()
        except URError:
            return False
        return bool(self.time["paused"])

    async def call(self, verb: str, **arguments: Any) -> Any:
        """Call a verb and return its result. Raises URError with the emulator's reason."""
        return (await self._answer_to(*self._protocol.call(verb, arguments)))["result"]

    async def follow(self, dialogues: Dialogues) -> None:
        """Poll whether there is an emulator, and which dialogues it shows, forever."""
        missed = _MAX_MISSES
        while self._port:
            try:
                if missed:
                    await self._query_verbs()
                dialogues.synchronise(await self.call("popups"))
                await self.update_time()
                missed = 0
            except (URError, KeyError, TypeError):  # there is none, or something else answers
                missed += 1
                if missed >= _MAX_MISSES and self.available:
                    self.available, self.time = False, {}
                    dialogues.synchronise([])  # they were the emulator's
                    self._on_change()
            await self._wait()

    async def _query_verbs(self) -> None:
        try:
            self.verbs = frozenset(entry["name"] for entry in await self._answer_to(*LIST_VERBS))
        except NoAccessError:
            self.locked = True
            raise
        self.locked = False
        self.catalogue = {verb: await self.call(verb) for verb in _CATALOGUE if verb in self.verbs}
        self.available = True

    async def _answer_to(self, method: str, path: str, body: bytes | None) -> Any:
        try:
            response = await self._http.request(method, path, content=body, headers=self._protocol.headers)
        except httpx.HTTPError as error:
            raise self._protocol.unreachable(error) from error
        return self._protocol.answer(response.status_code, response.content)
