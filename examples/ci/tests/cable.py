"""A network cable that can be pulled: connections stay, as with a real one, but nothing arrives any more.

It is a process of its own, since drivers written in C++ may stop all Python of theirs while they wait.
"""

import asyncio
import subprocess
import sys

from urtesting.process import claim_address

PORTS = (29999, 30001, 30002, 30003, 30004)


class Cable:
    """Leads the usual ports of an address of its own, ``host``, to those of a robot."""

    def __init__(self, robot_host: str) -> None:
        self._address = claim_address()
        self.host = self._address.host
        self._command = [sys.executable, __file__, self.host, robot_host]

    def __enter__(self) -> "Cable":
        self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._wait_for("plugged")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
        self._address.release()

    def pull(self) -> None:
        """From now on nothing passes."""
        self._send("pulled")

    def plug(self) -> None:
        """What waited passes, and all that follows."""
        self._send("plugged")

    def _send(self, word: str) -> None:
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()
        self._wait_for(word)

    def _wait_for(self, word: str) -> None:
        answer = self._process.stdout.readline().strip()
        if answer != word:
            raise RuntimeError(f"the cable says {answer!r} instead of {word!r}")


class Relay:
    """The process: obeys the lines on its standard input, ends with them."""

    def __init__(self, host: str, robot_host: str) -> None:
        self._host, self._robot_host = host, robot_host
        self._plugged = asyncio.Event()

    async def run(self) -> None:
        servers = [await self._open(port) for port in PORTS]
        self._obey("plugged")
        words = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(words), sys.stdin)
        while word := (await words.readline()).decode().strip():
            self._obey(word)
        for server in servers:
            server.close()

    def _obey(self, word: str) -> None:
        if word == "plugged":
            self._plugged.set()
        else:
            self._plugged.clear()
        print(word, flush=True)

    async def _open(self, port: int) -> asyncio.Server:
        async def connected(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await self._plugged.wait()
            robot_reader, robot_writer = await asyncio.open_connection(self._robot_host, port)
            await asyncio.gather(self._pump(reader, robot_writer), self._pump(robot_reader, writer))

        return await asyncio.start_server(connected, self._host, port)

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(65536):
                await self._plugged.wait()
                writer.write(data)
                await writer.drain()
        except ConnectionError:
            pass
        finally:
            writer.close()


if __name__ == "__main__":
    asyncio.run(Relay(*sys.argv[1:]).run())
