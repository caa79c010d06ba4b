"""The verbs of a running emulator, over its control API.

    robot = RemoteControl("127.0.0.1")
    robot.press_emergency_stop()

Each verb is a method, with the arguments and results that docs/reference/control_verbs.md lists.
"""

import http.client
import json
from collections.abc import Callable, Mapping
from typing import Any

from urproto.ports import CONTROL_API_PORT

_BAD_ARGUMENTS, _CONFLICT, _NOT_FOUND = 400, 409, 404


class BadArguments(ValueError):  # noqa: N818 - named for what is the case
    """The arguments do not fit the verb, whatever state the robot is in."""


class NotPossible(Exception):  # noqa: N818 - named for what is the case
    """The robot cannot do that in the state it is in."""


class NoControlError(ConnectionError):
    """The control API cannot be reached, or refuses this client."""


class ControlClient:
    """Calls verbs by name. ``timeout_s``: time limit for an answer; None for no limit."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = CONTROL_API_PORT, token: str = "", timeout_s: float | None = 60.0
    ) -> None:
        self._place = f"{host} port {port}"
        self._http = http.client.HTTPConnection(host, port, timeout=timeout_s)
        self._headers = {"Content-Type": "application/json"}
        if token:
            self._headers["Authorization"] = f"Bearer {token}"

    def close(self) -> None:
        """Close the connection; the next call opens a new one."""
        self._http.close()

    def verbs(self) -> list[dict[str, Any]]:
        """List the verbs: name, text and arguments of each. Raises NoControlError."""
        listed: list[dict[str, Any]] = self._request("GET", "/verbs", None)
        return listed

    def call(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """The result of a verb. Raises BadArguments, NotPossible, AttributeError if it is unknown, NoControlError."""
        return self._request("POST", f"/verbs/{verb}", arguments)["result"]

    def _request(self, method: str, path: str, arguments: Mapping[str, Any] | None) -> Any:
        body = None if arguments is None else json.dumps(arguments).encode()
        try:
            self._http.request(method, path, body, self._headers)
            response = self._http.getresponse()
            content = json.loads(response.read())
        except (OSError, http.client.HTTPException, ValueError) as error:
            self._http.close()
            reason = getattr(error, "strerror", None) or error or type(error).__name__
            raise NoControlError(
                f"no control API on {self._place} ({reason}): start the emulator, or check address and port"
            ) from error
        if response.status != http.client.OK:
            raise _error(response.status, content.get("error", ""))
        return content


def _error(status: int, text: str) -> Exception:
    kinds: dict[int, type[Exception]] = {
        _BAD_ARGUMENTS: BadArguments,
        _CONFLICT: NotPossible,
        _NOT_FOUND: AttributeError,
    }
    return kinds.get(status, NoControlError)(text)


class RemoteControl:
    """The verbs of an emulator as methods. Arguments as for ControlClient."""

    def __init__(self, *place: Any, **options: Any) -> None:
        self._client = ControlClient(*place, **options)
        self._arguments = {verb["name"]: [a["name"] for a in verb["arguments"]] for verb in self._client.verbs()}

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def __getattr__(self, name: str) -> Callable[..., Any]:
        if name.startswith("_") or name not in self._arguments:
            raise AttributeError(f"the control API has no verb {name!r}")

        def call(*values: Any, **named: Any) -> Any:
            if len(values) > len(self._arguments[name]):
                raise BadArguments(f"{name} takes {len(self._arguments[name])} arguments, not {len(values)}")
            given = dict(zip(self._arguments[name], values, strict=False))
            return self._client.call(name, given | named)

        return call
