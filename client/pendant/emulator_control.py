"""The control API of an emulator, which a real robot does not have."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final

import httpx

from client.errors import ClientError
from client.pendant.dialogues import Dialogues
from client.pendant.polling import Poller

LOOK_AGAIN_S: Final = 0.5  # while somebody looks
_LOOK_EVERY_S: Final = 1.0
_CATALOGUE: Final = ("describe", "fault_kinds", "ports", "safety_causes")
_OF_TIME: Final = ("set_speed", "pause_time", "resume_time", "step")
_MISSES: Final = 3  # in a row, and there is no emulator any more (guess)
_OK: Final = 200
_UNAUTHORIZED: Final = 401


class EmulatorControlError(ClientError):
    """The control API of an emulator refused a verb, or is not available."""


async def _rest() -> None:
    await asyncio.sleep(LOOK_AGAIN_S)


class EmulatorControl:
    """Verbs of an emulator's control API (docs/control_verbs.md).

    available: the API answers, so this is not a real robot. port: 0 for none. token: the token that the emulator
    expects. locked: the emulator expects another token. time: the result of the verb of this name, empty before the
    first. catalogue: results of verbs that do not change. tell: called when something to show has changed. rest: waits
    between two queries of ``follow``.
    """

    def __init__(
        self, host: str, port: int, token: str, tell: Callable[[], None], rest: Callable[[], Awaitable[None]] = _rest
    ) -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._port = port
        base = f"http://{host}:{port}"
        self._http = httpx.AsyncClient(base_url=base, headers=headers, timeout=5.0, trust_env=False)
        self._tell = tell
        self._rest = rest
        self._watched: dict[tuple[str, str], Poller[Any]] = {}
        self.available = False
        self.locked = False
        self.verbs: frozenset[str] = frozenset()
        self.catalogue: Mapping[str, Any] = {}
        self.time: Mapping[str, Any] = {}

    async def close(self) -> None:
        """End the connection."""
        for watched in self._watched.values():
            await watched.close()
        await self._http.aclose()

    def watch(self, verb: str, **arguments: str) -> Poller[Any]:
        """The result of a verb that changes nothing, asked for every second while a page shows it."""
        question = (verb, repr(sorted(arguments.items())))
        if question not in self._watched:
            self._watched[question] = Poller(lambda: self.call(verb, **arguments), _LOOK_EVERY_S, self._tell)
        return self._watched[question]

    async def change(self, verb: str, **arguments: Any) -> Any:
        """As ``call``, for a verb that changes what is watched: that is asked for at once."""
        try:
            result = await self.call(verb, **arguments)
            if verb in _OF_TIME:
                await self.look_at_the_time()
            return result
        finally:
            for watched in self._watched.values():
                watched.refresh()

    @property
    def pace(self) -> str:
        """How time goes by where it does not do so as for everybody else, "" otherwise."""
        if self.time.get("paused", False):
            return "time paused"
        speed = self.time.get("speed", 1.0)
        return "" if speed == 1.0 else f"time {speed:g}×" if speed else "time at its fastest"

    @property
    def expected(self) -> bool:
        """There is one, whether it lets this pendant in or not."""
        return self.available or self.locked

    async def look_at_the_time(self) -> None:
        """Ask for ``time``. Raises EmulatorControlError."""
        before, self.time = self.time, await self.call("time")
        names = ("paused", "speed", "time_s") if self.time["paused"] else ("paused", "speed")
        if any(before.get(name) != self.time[name] for name in names):
            self._tell()

    async def stands_still(self) -> bool:
        """Time is paused: no wonder that nothing comes."""
        try:
            await self.look_at_the_time()
        except EmulatorControlError:
            return False
        return bool(self.time["paused"])

    async def call(self, verb: str, **arguments: Any) -> Any:
        """The result of a verb. Raises EmulatorControlError with the emulator's reason."""
        try:
            response = await self._http.post(f"/verbs/{verb}", json=arguments)
            content: Mapping[str, Any] = response.json()
        except (httpx.HTTPError, ValueError) as error:
            raise EmulatorControlError(
                f"{verb}: no control API at {self._http.base_url}: {error or type(error).__name__}"
            ) from error
        if response.status_code != _OK:
            raise EmulatorControlError(f"{verb}: {content.get('error', response.status_code)}")
        return content["result"]

    async def follow(self, dialogues: Dialogues) -> None:
        """Look whether there is an emulator, and which dialogues it shows, for ever."""
        missed = _MISSES
        while self._port:
            try:
                if missed:
                    await self._find()
                dialogues.are(await self.call("popups"))
                await self.look_at_the_time()
                missed = 0
            except EmulatorControlError:
                missed += 1
                if missed >= _MISSES and self.available:
                    self.available, self.time = False, {}
                    dialogues.are([])  # they were the emulator's
                    self._tell()
            await self._rest()

    async def _find(self) -> None:
        try:
            response = await self._http.get("/verbs")
            self.locked = response.status_code == _UNAUTHORIZED
            self.verbs = frozenset(entry["name"] for entry in response.json())
        except (httpx.HTTPError, ValueError, TypeError, KeyError) as error:
            raise EmulatorControlError(f"no control API at {self._http.base_url}") from error
        self.catalogue = {verb: await self.call(verb) for verb in _CATALOGUE if verb in self.verbs}
        self.available = response.status_code == _OK
