"""The web page of a class: all robots of a fleet, with a link for each student.

A teacher and the students have a password each. Both see the robots and may open their pendants; only the teacher may
stop, reset and name them. The page runs in a separate process, which also runs the pendants, from the first use of a
robot's link on.
"""

import asyncio
import hmac
import multiprocessing
import secrets
import signal
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from functools import partial
from multiprocessing.connection import Connection as Link
from pathlib import Path
from typing import Any, Final

import msgspec

from emulator.config import ConfigError, EmulatorConfig
from emulator.fleet.class_robot import ClassRobot
from emulator.fleet.supervisor import join_or_kill
from emulator.servers import http
from emulator.servers.connection import Connection
from emulator.servers.port import Port
from urproto.addresses import BackdoorMark
from urproto.compat import Self
from urproto.errors import URError
from urproto.text import to_bytes

_SEE_OTHER: Final = 303
_STATIC: Final = Path(__file__).with_name("static")
_FILES: Final = {  # path -> file, type
    "/": ("class.html", "text/html; charset=utf-8"),
    "/class.css": ("class.css", "text/css"),
    "/class.js": ("class.js", "text/javascript"),
}
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_LOGIN, _ROBOTS, _LINK = "/login", "/robots", "/robot/"
_PERIOD_S: Final = 0.5  # between two queries of the robots while a browser shows the page
_UNWATCHED_S: Final = 3.0  # without a request: nobody watches (guess)
_THREADS: Final = 8  # that wait for robots
_MAX_NAME: Final = 40
_PASSWORD_BYTES: Final = 9


class _Login(msgspec.Struct):
    password: str


class _Command(msgspec.Struct):
    """robots: their numbers, from 1 on."""

    action: str
    robots: list[int]
    name: str = ""


class ClassServer(Port):
    """Serves the page. passwords: by role, ``teacher`` and ``student``."""

    def __init__(self, robots: Sequence[ClassRobot], passwords: Mapping[str, str], running: AsyncExitStack) -> None:
        super().__init__("class page")
        self.robots = robots
        self.passwords = passwords
        self.sessions = {secrets.token_urlsafe(): role for role in passwords}
        self.guesses = http.Guesses()
        self._running = running
        self._threads = ThreadPoolExecutor(_THREADS, "class page")
        self._tasks: set[asyncio.Task[None]] = set()
        self._watched_s = -_UNWATCHED_S
        self._watching = asyncio.Event()
        running.callback(self._threads.shutdown)

    def connect(self) -> Connection:
        return _ClassConnection(self)

    @property
    def cookie(self) -> str:
        """Name of the cookie: browsers send cookies to all ports of an address."""
        return f"class_{self.port}"

    def listing(self) -> list[dict[str, Any]]:
        """What the page shows of the robots, which are queried from now on."""
        self._watched_s = asyncio.get_running_loop().time()
        self._watching.set()
        return [robot.describe() for robot in self.robots]

    async def keep_querying(self) -> None:
        """Query the robots while a browser shows the page, forever."""
        clock = asyncio.get_running_loop().time
        while True:
            if clock() - self._watched_s > _UNWATCHED_S:
                self._watching.clear()
            await self._watching.wait()
            await asyncio.gather(*(self._in_thread(robot.query) for robot in self.robots))
            await asyncio.sleep(_PERIOD_S)

    def answer_later(self, connection: "_ClassConnection", work: Callable[[], Any]) -> None:
        """Answer a request with the result of a coroutine function."""

        async def answer() -> None:
            response = await work()
            if connection.is_open:
                connection.reply(response)

        task = asyncio.get_running_loop().create_task(answer())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def command(self, action: str, robots: Sequence[ClassRobot]) -> http.Response:
        """Stop or reset robots; the answer names those that could not be."""
        work = [robot.stop if action == "stop" else robot.reset for robot in robots]
        results = await asyncio.gather(*map(self._in_thread, work), return_exceptions=True)
        failed = {}
        for robot, result in zip(robots, results, strict=True):
            if isinstance(result, URError):
                failed[robot.name] = str(result)
            elif result is not None:
                raise result
        return http.Response(http.OK, {"failed": failed})

    async def open_pendant(self, robot: ClassRobot) -> http.Response:
        """Send the browser to the pendant of a robot."""
        try:
            address = await robot.open_pendant(self._running)
        except TimeoutError:
            late = {"error": f"the pendant of {robot.name} is still starting: this page asks again"}
            return http.Response(http.UNAVAILABLE, late, {"Refresh": "2"})
        except (RuntimeError, OSError) as error:
            return http.Response(http.UNAVAILABLE, {"error": f"the pendant of {robot.name} does not start: {error}"})
        return http.Response(_SEE_OTHER, b"", {"Location": address})

    async def _in_thread(self, work: Callable[[], None]) -> None:
        await asyncio.get_running_loop().run_in_executor(self._threads, work)


class _ClassConnection(http.HttpConnection):
    server: ClassServer
    max_body = 64 * 1024

    def admit(self, request: http.Request) -> None:
        http.check_host(request, also=http.is_local)
        if request.path in (_LOGIN, _ROBOTS):
            http.check_site(request)

    def methods(self, path: str) -> Collection[str]:
        if path in _FILES:
            return ("GET",)
        if path in (_LOGIN, _ROBOTS):
            return ("POST",) if path == _LOGIN else ("GET", "POST")
        if path.startswith(_LINK):
            self._numbered(path.removeprefix(_LINK))
            return ("GET",)
        raise http.HttpError(http.NOT_FOUND, f"nothing is served at {path[:100]}: the class page is at /")

    def answer(self, request: http.Request) -> http.Response | None:
        path = request.path
        if path in _FILES:
            name, kind = _FILES[path]
            headers = {"Content-Type": kind, "Content-Security-Policy": _POLICY}
            return http.Response(http.OK, (_STATIC / name).read_bytes(), headers)
        if path == _LOGIN:
            return self._log_in(request)
        role = self._role(request)
        if path.startswith(_LINK):
            if not role:
                return http.Response(_SEE_OTHER, b"", {"Location": f"/#{path}"})
            robot = self._numbered(path.removeprefix(_LINK))
            self.server.answer_later(self, partial(self.server.open_pendant, robot))
            return None
        if not role:
            raise http.HttpError(http.UNAUTHORIZED, "enter the password of the class")
        if request.method == "GET":
            return http.Response(http.OK, {"role": role, "robots": self.server.listing()})
        if role != "teacher":
            raise http.HttpError(http.FORBIDDEN, "only the teacher stops, resets and names robots")
        return self._command(_decoded(request, _Command))

    def _command(self, command: _Command) -> http.Response | None:
        robots = [self._numbered(str(number)) for number in command.robots]
        if command.action == "name":
            for robot in robots:
                robot.name = command.name.strip()[:_MAX_NAME] or robot.name
            return http.Response(http.OK, {"failed": {}})
        if command.action not in ("stop", "reset"):
            raise http.HttpError(http.BAD, f"there is no action {command.action[:20]!r}: use stop, reset or name")
        self.server.answer_later(self, partial(self.server.command, command.action, robots))
        return None

    def _numbered(self, number: str) -> ClassRobot:
        robots = self.server.robots
        if not number.isascii() or not number.isdigit() or not 1 <= int(number[:9]) <= len(robots):
            raise http.HttpError(http.NOT_FOUND, f"there is no robot {number[:20]}: there are 1 to {len(robots)}")
        return robots[int(number) - 1]

    def _role(self, request: http.Request) -> str:
        """The role of a browser, "" before it has given a password."""
        cookies = dict(
            part.strip().split("=", 1) for part in request.headers.get("cookie", "").split(";") if "=" in part
        )
        return self.server.sessions.get(cookies.get(self.server.cookie, ""), "")

    def _log_in(self, request: http.Request) -> http.Response | None:
        server, given = self.server, to_bytes(_decoded(request, _Login).password)
        for session, role in server.sessions.items():
            if hmac.compare_digest(given, to_bytes(server.passwords[role])):
                cookie = f"{server.cookie}={session}; HttpOnly; SameSite=Lax; Path=/"
                return http.Response(http.OK, {"role": role}, {"Set-Cookie": cookie})
        wrong = self.refuse(http.HttpError(http.UNAUTHORIZED, "this password is wrong"))
        delay_s = server.guesses.delay_s()

        async def refuse_later() -> http.Response:
            await asyncio.sleep(delay_s)
            return wrong

        server.answer_later(self, refuse_later)
        return None


def _decoded(request: http.Request, kind: type[Any]) -> Any:
    http.check_type(request, http.JSON)
    try:
        return msgspec.json.decode(request.body, type=kind)
    except (msgspec.DecodeError, UnicodeError, RecursionError) as error:
        raise http.HttpError(http.BAD, f"the body is not what the page sends: {error}") from error


def class_passwords(teacher: str, student: str) -> dict[str, str]:
    """The password of each role. Raises ConfigError if both are the same."""
    if teacher and teacher == student:
        raise ConfigError("--teacher-password and --student-password are the same: students could stop all robots")
    return {
        "teacher": teacher or secrets.token_urlsafe(_PASSWORD_BYTES),
        "student": student or secrets.token_urlsafe(_PASSWORD_BYTES),
    }


def check_class(configs: Sequence[EmulatorConfig]) -> None:
    """Check that the class page can be served. Raises ConfigError."""
    if not all(config.control for config in configs):
        raise ConfigError("the class page needs the control API of every robot: leave out --no-control")
    if any(config.ephemeral_ports for config in configs):
        raise ConfigError("the class page needs the usual ports: leave out --ephemeral-ports")


class ClassPage:
    """The process of the page while the context is entered. Raises ConfigError if it cannot be started.

    ports: of each robot, by server. port: of the page, at the first robot's address. passwords: by role.
    """

    def __init__(
        self,
        configs: Sequence[EmulatorConfig],
        ports: Sequence[Mapping[str, int]],
        port: int,
        passwords: Mapping[str, str],
    ) -> None:
        context = multiprocessing.get_context("spawn")  # a fork would keep the links of the fleet's processes open
        self._link, theirs = context.Pipe()
        arguments = (tuple(configs), tuple(ports), port, passwords, theirs)
        self._process = context.Process(target=_run, args=arguments, name="class page")
        self._theirs = theirs

    def __enter__(self) -> Self:
        self._process.start()
        self._theirs.close()
        try:
            problem = self._link.recv()
        except EOFError:
            problem = "its process has ended"
        if problem:
            self.__exit__(None, None, None)
            raise ConfigError(f"no class page: {problem}")
        return self

    def __exit__(self, *_: object) -> None:
        self._link.close()
        join_or_kill(self._process)


def _run(*arguments: Any) -> None:
    """Serve until the link, the last argument, is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all processes; the fleet decides
    asyncio.run(_serve(*arguments))


async def _serve(
    configs: Sequence[EmulatorConfig],
    ports: Sequence[Mapping[str, int]],
    port: int,
    passwords: Mapping[str, str],
    link: Link,
) -> None:
    numbered = enumerate(zip(configs, ports, strict=True), 1)
    robots = [ClassRobot(number, config, own_ports) for number, (config, own_ports) in numbered]
    ended = asyncio.Event()
    asyncio.get_running_loop().add_reader(link.fileno(), ended.set)  # the fleet never sends
    async with AsyncExitStack() as running:
        server = ClassServer(robots, passwords, running)
        try:
            await server.start(configs[0].host, port)
            running.callback(BackdoorMark(configs[0].host, port).close)
        except OSError as error:
            link.send(error.strerror or str(error))
            return
        running.push_async_callback(server.stop)
        querying = asyncio.create_task(server.keep_querying())
        running.callback(querying.cancel)
        link.send("")
        await ended.wait()
