"""An MCP server: what an assistant may see and do of a robot. `tools` has the tools, `consent` the addresses.

Model Context Protocol: https://modelcontextprotocol.io, by the official SDK.
"""

from importlib.util import find_spec

from client.errors import MissingExtraError

if find_spec("mcp") is None:
    raise MissingExtraError("the MCP server", "mcp")

from client.mcp.consent import Consent
from client.mcp.server import make_server
from client.mcp.tools import Tools

__all__ = ["Consent", "Tools", "make_server"]
