"""The verbs of a running emulator, over its control API.

    robot = RemoteControl("127.0.0.1")
    robot.press_emergency_stop()

Each verb is a method, with the arguments and results that docs/reference/control_verbs.md lists.
"""

import http.client
import json
from collections.abc import Callable, Mapping
from typing import Any, Final

from urproto.errors import URError
from urproto.ports import CONTROL_API_PORT

LIST_VERBS: Final = ("GET", "/verbs", None)
"""Method, path and body of the request that lists the verbs."""


class BadArguments(URError, ValueError):  # noqa: N818 - named for what is the case
    """The arguments do not fit the verb, whatever state the robot is in."""


class NotPossible(URError):  # noqa: N818 - named for what is the case
    """The robot cannot do that in the state it is in."""


class NoControlError(URError, ConnectionError):
    """The control API cannot be reached, or refuses this client."""


class NoAccessError(NoControlError):
    """The control API expects another token."""


_ERRORS: Final[Mapping[int, type[URError]]] = {
    400: BadArguments,
    401: NoAccessError,
    404: BadArguments,
    409: NotPossible,
}


class ControlProtocol:
    """The client's side of a control API, without I/O. headers: those of every request."""

    def __init__(self, host: str, port: int, token: str) -> None:
        self._place = f"{host} port {port}"
        self.headers = {"Content-Type": "application/json"} | ({"Authorization": f"Bearer {token}"} if token else {})

    def call(self, verb: str, arguments: Mapping[str, Any]) -> tuple[str, str, bytes]:
        """Method, path and body of the request that calls a verb. The answer has its ``result``."""
        return "POST", f"/verbs/{verb}", json.dumps(arguments).encode()

    def answer(self, status: int, body: bytes) -> Any:
        """The content of a response. Raises BadArguments, NotPossible, NoControlError."""
        try:
            content = json.loads(body)
            text = "" if status == http.client.OK else content["error"]
        except (ValueError, TypeError, KeyError) as error:
            raise self.unreachable(error) from error
        if status != http.client.OK:
            raise _ERRORS.get(status, NoControlError)(text)
        return content

    def unreachable(self, error: Exception) -> NoControlError:
        """What to raise for an error of the connection."""
        reason = getattr(error, "strerror", None) or error or type(error).__name__
        text = f"no control API on {self._place} ({reason}): start the emulator, or check address and port"
        return NoControlError(text)


class ControlClient:
    """Calls verbs by name. ``timeout_s``: time limit for an answer; None for no limit."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = CONTROL_API_PORT, token: str = "", timeout_s: float | None = 60.0
    ) -> None:
        self._protocol = ControlProtocol(host, port, token)
        self._http = http.client.HTTPConnection(host, port, timeout=timeout_s)

    def close(self) -> None:
        """Close the connection; the next call opens a new one."""
        self._http.close()

    def verbs(self) -> list[dict[str, Any]]:
        """List the verbs: name, text and arguments of each. Raises NoControlError."""
        return list(self._answer_to(*LIST_VERBS))

    def call(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """The result of a verb. Raises BadArguments, NotPossible, NoControlError."""
        return self._answer_to(*self._protocol.call(verb, arguments))["result"]

    def _answer_to(self, method: str, path: str, body: bytes | None) -> Any:
        try:
            self._http.request(method, path, body, self._protocol.headers)
            response = self._http.getresponse()
            content = response.read()
        except (OSError, http.client.HTTPException, ValueError) as error:
            self._http.close()
            raise self._protocol.unreachable(error) from error
        return self._protocol.answer(response.status, content)


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
