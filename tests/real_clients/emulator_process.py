"""The emulator process of these tests, and direct commands to it, bypassing the clients."""

import socket
from typing import TextIO

from urtesting.process import EmulatorProcess as Process

__all__ = ["EmulatorProcess"]


class EmulatorProcess(Process):
    """Uses the ports themselves, as the control API is not under test."""

    @property
    def log(self) -> str:
        """The last output of the emulator."""
        return self.output[-4000:]

    def dashboard(self, *lines: str) -> list[str]:
        """Send dashboard commands over a separate connection and return the answers."""
        with socket.create_connection((self.host, self.ports["dashboard"]), timeout=10) as connection:
            stream = connection.makefile("rw", newline="\n")
            greeting = stream.readline()
            assert greeting == "Connected: Universal Robots Dashboard Server\n", greeting
            return [_request(stream, line) for line in lines]

    def send_script(self, text: str) -> None:
        """Send text to the secondary script port."""
        with socket.create_connection((self.host, self.ports["secondary"]), timeout=10) as connection:
            connection.sendall(text.encode())
            connection.shutdown(socket.SHUT_WR)


def _request(stream: TextIO, line: str) -> str:
    stream.write(f"{line}\n")
    stream.flush()
    return stream.readline().rstrip("\n")
