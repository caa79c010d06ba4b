"""Foreign web pages in a browser on the same machine as an emulator cannot control it."""

import socket
import threading
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from playwright.sync_api import Browser, Error, Page, Playwright

from tests.pendant.conftest import CHROMIUM, FLAGS, eventually
from urproto.testing.process import EmulatorProcess

FOREIGN, REBOUND = "evil.test", "rebound.test"  # host names of the page, and of the robot after DNS rebinding
BODY = """
power off
set_standard_digital_out(0, True)
def page():
  set_standard_digital_out(1, True)
  movej([0.5, -1.2, 0.8, -1.2, -1.5, 0.0])
end
play
SET ACT 1 GTO 1 POS 255
"""
HTTP_PORTS = {"control"}  # speaks HTTP and checks its requests
# every way in which a page can open a connection; each one times out
ATTACK = """([host, ports, body]) => Promise.all(ports.map(async port => {
  const url = `http://${host}:${port}`;
  const soon = () => ({mode: 'no-cors', signal: AbortSignal.timeout(5000)});
  const text = {'Content-Type': 'text/plain'};
  const json = {'Content-Type': 'application/json'};
  const input = '{"index":0,"level":true}';
  const frame = document.body.appendChild(document.createElement('iframe'));
  frame.name = `frame${port}`;
  const form = document.body.appendChild(document.createElement('form'));
  Object.assign(form, {method: 'POST', action: `${url}/form`, target: frame.name, enctype: 'text/plain'});
  const field = form.appendChild(document.createElement('textarea'));
  Object.assign(field, {name: '\\n', value: body});
  form.submit();
  navigator.sendBeacon(`${url}/beacon`, body);
  const socket = new WebSocket(`ws://${host}:${port}/socket`);
  const ended = new Promise(done => { socket.onclose = done; setTimeout(done, 5000); });
  await Promise.allSettled([
    fetch(`${url}/get`, soon()),
    fetch(`${url}/post`, {...soon(), method: 'POST', headers: text, body}),
    fetch(`${url}/bytes`, {...soon(), method: 'POST', body: new Uint8Array(30000).fill(10)}),
    fetch(`${url}/${'long'.repeat(2000)}`, {...soon(), method: 'POST', headers: text, body}),
    fetch(`${url}/put`, {...soon(), mode: 'cors', method: 'PUT', headers: json, body}),
    fetch(`https://${host}:${port}/tls`, {...soon(), method: 'POST', body}),
    fetch(`${url}/verbs/set_digital_input`, {...soon(), method: 'POST', headers: text, body: input}),
    fetch(`${url}/verbs/power_off`, {...soon(), mode: 'cors', method: 'POST', headers: json, body: '{}'}),
    ended,
  ]);
}))"""
ASK = """async path => (await fetch(path, {
  method: 'POST', headers: {'Content-Type': 'application/json'}, body: '{"index":0,"level":true}',
})).status"""


class EmptyPage(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        content = b"<!doctype html><title>Kittens</title><body></body>"
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        """Keep requests out of the test report."""


@pytest.fixture(scope="module")
def robot() -> Iterator[EmulatorProcess]:
    options = ["--model", "ur5e", "--running", "--gripper", "robotiq-2f-85", "--tool-device", "echo"]
    with EmulatorProcess(options) as robot:
        yield robot


@pytest.fixture(scope="module")
def foreign_page() -> Iterator[str]:
    """Address of a foreign page."""
    server = HTTPServer(("127.0.0.1", 0), EmptyPage)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    yield f"http://{FOREIGN}:{server.server_port}/"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture(scope="module")
def browser_with_names(playwright: Playwright, robot: EmulatorProcess) -> Iterator[Browser]:
    """A browser that resolves the page's name to this machine and the rebound name to the robot."""
    rules = f"--host-resolver-rules=MAP {FOREIGN} 127.0.0.1, MAP {REBOUND} {robot.host}"
    browser = playwright.chromium.launch(executable_path=CHROMIUM, args=[*FLAGS, rules])
    yield browser
    browser.close()


@pytest.fixture
def page(browser_with_names: Browser) -> Iterator[Page]:
    context = browser_with_names.new_context()
    yield context.new_page()
    context.close()


@pytest.fixture
def untouched(robot: EmulatorProcess) -> Iterator[None]:
    """Checks that the robot has not changed after the test."""
    names = ["robot_mode", "safety_mode", "actual_q", "actual_digital_output_bits", "actual_digital_input_bits"]
    names += ["runtime_state", "speed_scaling"]
    before, messages = robot.state(names), robot.log(1000)
    yield
    robot.run_until(f"timestamp > {robot.state(['timestamp'])['timestamp'] + 0.5}")  # a program would have started
    assert robot.state(names) == before
    assert robot.log(1000) == messages
    with socket.create_connection((robot.host, robot.ports["gripper"]), timeout=10) as gripper:
        gripper.sendall(b"GET ACT\n")
        assert gripper.recv(100) == b"ACT 0\n"


@pytest.mark.long
@pytest.mark.usefixtures("untouched")
def test_foreign_page_cannot_use_any_port(robot: EmulatorProcess, foreign_page: str, page: Page) -> None:
    page.goto(foreign_page)
    page.evaluate(ATTACK, [robot.host, list(robot.ports.values()), BODY])
    for name in set(robot.ports) - HTTP_PORTS:
        eventually(lambda name=name: robot.turned_away().get(name, {}).get("http", 0) >= 8)  # each but TLS
        eventually(lambda name=name: robot.turned_away()[name].get("tls", 0) >= 1)
    assert set(robot.turned_away()) == set(robot.ports) - HTTP_PORTS
    messages = [line for line in robot.output.splitlines() if "HTTP request" in line or "TLS" in line]
    assert len(messages) == 2 * (len(robot.ports) - len(HTTP_PORTS)), "a line a minute for each port and reason"


@pytest.mark.long
@pytest.mark.usefixtures("untouched")
def test_dns_rebinding_is_rejected(robot: EmulatorProcess, page: Page) -> None:
    forbidden = 403
    answer = page.goto(f"http://{REBOUND}:{robot.ports['control']}/")
    assert answer is not None
    assert answer.status == forbidden
    with pytest.raises(Error, match="Failed to fetch"):  # the answer's policy lets a page ask for nothing
        page.evaluate(ASK, "/verbs/set_digital_input")
    with closing(HTTPConnection(robot.host, robot.ports["control"])) as connection:
        connection.request("POST", "/verbs/set_digital_input", b"{}", {"Host": REBOUND})
        assert connection.getresponse().status == forbidden
