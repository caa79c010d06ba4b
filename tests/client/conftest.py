"""A robot's port that does as the test says."""

import socket
import threading
from collections.abc import Callable, Iterator

import pytest

Handler = Callable[[socket.socket], None]
PATIENCE_S = 10.0


@pytest.fixture
def serve() -> Iterator[Callable[[Handler], int]]:
    """``serve(handler)`` listens on a free port, gives each connection to the handler, returns the port."""
    running: list[tuple[socket.socket, threading.Thread]] = []

    def start(handler: Handler) -> int:
        listener = socket.create_server(("127.0.0.1", 0))
        thread = threading.Thread(target=_accept, args=(listener, handler), daemon=True)
        thread.start()
        running.append((listener, thread))
        return int(listener.getsockname()[1])

    yield start
    for listener, thread in running:
        listener.shutdown(socket.SHUT_RDWR)
        thread.join(PATIENCE_S)
        listener.close()


def _accept(listener: socket.socket, handler: Handler) -> None:
    while True:
        try:
            connection, _ = listener.accept()
        except OSError:
            return
        connection.settimeout(PATIENCE_S)
        with connection:
            try:
                handler(connection)
            except OSError:  # the client went away first
                continue
