"""Answers to XML-RPC calls over HTTP."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias
from xmlrpc.client import Fault, dumps, loads

from emulator.peers.answers import Reply
from emulator.peers.log import PeerLog

Method: TypeAlias = Callable[..., Any]


@dataclass
class XmlRpcMethods:
    """The methods of a server; one that is missing, or raises an error, answers with a fault."""

    log: PeerLog
    methods: Mapping[str, Method] | Any  # or an object whose public methods they are

    def cut(self, buffer: bytearray, idle: bool) -> Iterator[bytes]:
        """Take complete HTTP requests off the buffer."""
        while (head := buffer.find(b"\r\n\r\n") + 4) > 3:
            end = head + _content_length(bytes(buffer[:head]))
            if len(buffer) < end:
                return
            yield bytes(buffer[head:end])
            del buffer[:end]

    def answer(self, message: bytes) -> Reply:
        arguments, name = loads(message)
        self.log.add(f"{name}({', '.join(map(str, arguments))})")
        body = dumps(self._call(str(name), arguments), methodresponse=True, allow_none=True).encode()
        return Reply(b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nContent-Length: %d\r\n\r\n%s" % (len(body), body))

    def _call(self, name: str, arguments: tuple[Any, ...]) -> tuple[Any] | Fault:
        public = None if name.startswith("_") else name
        found = (
            self.methods.get(name) if isinstance(self.methods, Mapping) else getattr(self.methods, public or "", None)
        )
        if found is None:
            return Fault(1, f"the peer {self.log.name} has no method {name}")
        try:
            return (found(*arguments),)
        except Fault as fault:
            return fault
        except Exception as error:
            return Fault(1, f"{name}: {error}")


def _content_length(head: bytes) -> int:
    for line in head.split(b"\r\n"):
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"content-length":
            return int(value)
    return 0
