"""Remote procedure calls: ``camera = rpc_factory("xmlrpc", "http://10.0.0.1:50000")``, ``camera.snapshot()``.

A call blocks its thread until the server has answered; other threads continue. Any failure
ends the program with an error that names the method and the server.
"""

from collections.abc import Generator
from typing import Final

from emulator.builtins.host import Frames, ProgramHost
from emulator.builtins.remote.connections import (
    HttpConnection,
    HttpUrl,
    PacketConnection,
    RemoteConnection,
    RemoteError,
)
from emulator.builtins.remote.xmlrpc import BadReplyError, Reply, encode_call, to_value
from urscript.builtins import Library
from urscript.compiler import STRUCT
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.methods import Handle
from urscript.values import Str, Value

LIBRARY: Final = Library("remote procedure calls", host=True)

_CLOSE: Final = "closeXMLRPCClientConnection"
_FACTORY_WORK: Final = 4000  # meter units: parsing a URL takes some 50 us
_LONGEST_TEXT: Final = 300  # characters of a server's error message (guess)


@LIBRARY.builtin()
def rpc_factory(host: ProgramHost, type_: Str, url: Str) -> Frames[Handle]:
    """A handle whose methods are those of an XML-RPC server.

    ``http://address:port/path`` (port 80 unless given) connects when the first method is
    called; only then does a missing server end the program. ``address:port`` is a packet
    stream, xmlrpc-c's protocol without HTTP, and connects immediately. The handle's
    ``closeXMLRPCClientConnection()`` closes the connection; the next call opens it again.
    """
    if type_ != "xmlrpc":
        raise RuntimeFault(f'rpc_factory: there is no RPC type "{type_}": the only one is "xmlrpc"')
    charge(_FACTORY_WORK)
    stream = PacketConnection.parse(host, url)
    try:
        if stream is None:
            return XmlRpcHandle(host, HttpConnection(host, HttpUrl.parse(url)))
        yield from stream.open()
    except (ValueError, RemoteError) as error:
        raise RuntimeFault(f'rpc_factory: "{url}" cannot be used: {error}') from None
    return XmlRpcHandle(host, stream)


class XmlRpcHandle(Handle):
    """Handle to the methods of a server. Threads may share it: their calls take turns."""

    type_title = "RPC handle"

    def __init__(self, host: ProgramHost, connection: RemoteConnection) -> None:
        self._host = host
        self._connection = connection
        self._busy = False

    def __str__(self) -> str:
        return f"rpc_factory({self._connection})"

    def member(self, name: str) -> Value:
        """The first part of a dotted method name, as in ``handle.system.listMethods()``."""
        return _DottedName(self, name)

    def call_method(self, name: str, arguments: tuple[Value, ...]) -> Generator[None, None, Value]:
        """Call a method of the server and wait for what it returns."""
        while self._busy:
            yield
        if name == _CLOSE:
            self._connection.close()
            return None
        self._busy = True
        try:
            return (yield from self._call(name, arguments))
        except (RemoteError, BadReplyError) as error:
            text = str(error)[:_LONGEST_TEXT]
            raise RuntimeFault(f"RPC {name} at {self._connection}: {text}") from None
        finally:
            self._busy = False

    def _call(self, name: str, arguments: tuple[Value, ...]) -> Frames[Value]:
        call = yield from encode_call(name, arguments)
        reply = Reply()
        yield from self._connection.post(call, reply.feed)
        structs = STRUCT.covers(self._host.machine.version)
        return (yield from to_value(reply.close(), structs=structs))


class _DottedName(Handle):
    """The first part of a dotted method name, before its call."""

    type_title = "RPC handle"

    def __init__(self, handle: XmlRpcHandle, prefix: str) -> None:
        self._handle = handle
        self._prefix = prefix

    def member(self, name: str) -> Value:
        return _DottedName(self._handle, f"{self._prefix}.{name}")

    def call_method(self, name: str, arguments: tuple[Value, ...]) -> Generator[None, None, Value]:
        return (yield from self._handle.call_method(f"{self._prefix}.{name}", arguments))
