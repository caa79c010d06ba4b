"""The server: tools of `client.mcp.tools` as MCP's, with errors in one line."""

import inspect
from collections.abc import Awaitable, Callable
from functools import wraps
from typing import Any

from mcp.server.mcpserver import MCPServer
from mcp.server.mcpserver.exceptions import ToolError
from mcp.types import ToolAnnotations

from client.mcp.consent import Consent
from client.mcp.tools import CHANGING, READING, Tools
from urproto.errors import URError

_INSTRUCTIONS = """Tools for Universal Robots arms. Each answer says in answered_by whether an emulator or a real arm
spoke; a real arm can hurt people. Try programs with check_program and try_program before they are sent to a robot.
Angles are in rad, lengths in m. {}"""
_READ_ONLY = "Nothing moves: the person who started this server did not pass --allow-motion."
_MOTION = "The person who started this server allowed motion."


def make_server(tools: Tools, consent: Consent, version: str) -> MCPServer[None]:
    """A server with the tools that the consent covers."""
    server: MCPServer[None] = MCPServer(
        "ur-client",
        title="Universal Robots",
        instructions=_INSTRUCTIONS.format(_MOTION if consent.motion else _READ_ONLY),
        version=version,
        log_level="WARNING",
    )
    for tool in (*READING, *(CHANGING if consent.motion else ())):
        moves = tool in CHANGING
        hints = ToolAnnotations(read_only_hint=not moves, destructive_hint=moves, open_world_hint=False)
        server.add_tool(_in_words(getattr(tools, tool.__name__)), annotations=hints)
    return server


def _in_words(tool: Callable[..., Awaitable[Any]]) -> Callable[..., Awaitable[Any]]:
    @wraps(tool)
    async def call(*values: Any, **named: Any) -> Any:
        try:
            return await tool(*values, **named)
        except (URError, OSError, ValueError, TimeoutError) as error:
            raise ToolError(str(error) or type(error).__name__) from error

    call.__signature__ = inspect.signature(tool)  # type: ignore[attr-defined]
    return call
