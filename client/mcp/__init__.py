"""An MCP server: what an assistant may see and do of a robot.

Model Context Protocol: https://modelcontextprotocol.io, by the official SDK.
"""

from importlib.util import find_spec

from client.errors import MissingExtraError

if find_spec("mcp") is None:
    raise MissingExtraError("the MCP server", "mcp")

from client.mcp.tools import Consent, Tools, make_server

__all__ = ["Consent", "Tools", "make_server"]
