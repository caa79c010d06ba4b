"""Behind the scenes of an emulator: its control API, which a robot does not have."""

import asyncio
from collections.abc import Mapping
from typing import Any, Final

import httpx

from client.errors import ClientError
from client.pendant.dialogues import Dialogues

__all__ = ["CONTROL_PORT", "Behind", "BehindError"]

CONTROL_PORT: Final = 30080
_LOOK_AGAIN_S: Final = 0.5
_OK: Final = 200


class BehindError(ClientError):
    """An emulator's control API refused a verb, or is not there."""


class Behind:
    """Verbs of an emulator's control API (docs/control_verbs.md). available: there is one; so this is no robot.

    port: 0 for none. token: what the emulator was told to ask for.
    """

    def __init__(self, host: str, port: int, token: str = "") -> None:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._port = port
        base = f"http://{host}:{port}"
        self._http = httpx.AsyncClient(base_url=base, headers=headers, timeout=5.0, trust_env=False)
        self.available = False
        self.verbs: frozenset[str] = frozenset()

    async def close(self) -> None:
        """End the connection."""
        await self._http.aclose()

    async def call(self, verb: str, **arguments: Any) -> Any:
        """The result of a verb. Raises BehindError with the emulator's reason."""
        try:
            response = await self._http.post(f"/verbs/{verb}", json=arguments)
            content: Mapping[str, Any] = response.json()
        except (httpx.HTTPError, ValueError) as error:
            raise BehindError(
                f"{verb}: no control API at {self._http.base_url}: {error or type(error).__name__}"
            ) from error
        if response.status_code != _OK:
            raise BehindError(f"{verb}: {content.get('error', response.status_code)}")
        return content["result"]

    async def follow(self, dialogues: Dialogues) -> None:
        """Look whether there is an emulator, and which dialogues it shows, for ever."""
        while self._port:
            try:
                if not self.available:
                    await self._find()
                dialogues.are(await self.call("popups"))
            except BehindError:
                self.available = False
            await asyncio.sleep(_LOOK_AGAIN_S)

    async def _find(self) -> None:
        try:
            response = await self._http.get("/verbs")
            self.verbs = frozenset(entry["name"] for entry in response.json())
        except (httpx.HTTPError, ValueError, TypeError, KeyError) as error:
            raise BehindError(f"no control API at {self._http.base_url}") from error
        self.available = response.status_code == _OK
