"""Parts of asyncio that Python 3.10 lacks, or that behave differently there.

In Python 3.10, `asyncio.wait_for` raises an error of asyncio's own, which ``except TimeoutError`` does not catch: use
`timeout`.
"""

import asyncio
import sys

if sys.version_info >= (3, 11):
    from asyncio import timeout
else:
    from collections.abc import AsyncIterator
    from contextlib import asynccontextmanager

    import async_timeout

    @asynccontextmanager
    async def timeout(delay: float | None) -> AsyncIterator[None]:
        """Like asyncio's own: raises TimeoutError when its body takes longer than this [s]; None for no limit."""
        try:
            async with async_timeout.timeout(delay):
                yield
        except asyncio.TimeoutError as error:
            raise TimeoutError from error


__all__ = ["pause_reading", "timeout"]


def pause_reading(transport: asyncio.Transport) -> None:
    """Like the transport's own method, which in 3.10 does nothing while the connection is being established."""
    transport.pause_reading()
    if sys.version_info < (3, 11):
        asyncio.get_running_loop().call_soon(_pause_again, transport)


def _pause_again(transport: asyncio.Transport) -> None:
    if not transport.is_closing() and not transport.is_reading():
        transport.resume_reading()
        transport.pause_reading()
