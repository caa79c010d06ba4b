"""Security policy of the pages in a browser, and their reconnection after a restart of the pendant."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from playwright.sync_api import Browser, Page, expect

from client.pendant.screens import SCREENS
from tests.pendant.conftest import Rig, eventually
from tests.pendant.pendants import pendant

OpenPage = Callable[[str], Page]
REFUSED = """() => {
  const seen = [];
  addEventListener("securitypolicyviolation", (event) => seen.push(event.violatedDirective));
  return seen;
}"""


@contextmanager
def serve_site(text: str) -> Iterator[str]:
    """Serve another site; yields its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(text.encode())

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def test_every_screen_complies_with_security_policy(open_page: OpenPage) -> None:
    page = open_page("initialize")  # which fails on policy violations
    refused = page.evaluate_handle(REFUSED)
    for screen in SCREENS:
        tab = page.get_by_test_id(f"tab-{screen.name}")
        tab.evaluate("element => element.click()")  # also hidden tabs
        expect(page.locator(".screen")).to_be_visible()
    page.get_by_label("Dark or light").click()
    assert refused.json_value() == []


@pytest.mark.long
def test_security_policy_blocks_injected_scripts_and_requests(rig: Rig, browser: Browser) -> None:
    context = browser.new_context()
    try:
        page = context.new_page()
        page.goto(rig.url)
        refused = page.evaluate_handle(REFUSED)
        page.evaluate("document.body.append(Object.assign(document.createElement('script'), {textContent: 'bad = 1'}))")
        assert page.evaluate("typeof bad") == "undefined"
        eventually(lambda: refused.json_value() == ["script-src-elem"])
        page.evaluate("fetch('http://127.0.0.1:1/').catch(() => 0)")
        eventually(lambda: refused.json_value() == ["script-src-elem", "connect-src"])
    finally:
        context.close()


def test_other_sites_cannot_frame_pendant(rig: Rig, browser: Browser) -> None:
    context = browser.new_context()
    try:
        page = context.new_page()
        messages = list[str]()
        page.on("console", lambda message: messages.append(message.text))
        with serve_site(f'<iframe id="trap" src="{rig.url}/move" width="900" height="700"></iframe>') as address:
            page.goto(address)
            eventually(lambda: any("frame-ancestors" in text for text in messages))
            assert page.frame_locator("#trap").locator(".robot-name").count() == 0
    finally:
        context.close()


@pytest.mark.long
def test_page_reconnects_after_pendant_restart(rig: Rig, browser: Browser) -> None:
    options = ("--port", "6082", "--control-port", "0")
    context = browser.new_context()
    try:
        page = context.new_page()
        with pendant(rig.host, *options) as first:
            # A page that has not connected yet cannot lose its connection: values come after the handshake.
            with page.expect_event("websocket", lambda socket: "/live/" in socket.url):
                page.goto(f"http://{rig.host}:6082/move")
            expect(page.get_by_test_id("angle-0")).not_to_have_text("\N{EN DASH}")
            first.kill()
            expect(page.get_by_text("Connection lost")).to_be_visible()
        with pendant(rig.host, *options):
            expect(page.get_by_text("The pendant was restarted")).to_be_visible()
            expect(page.get_by_test_id("angle-0")).not_to_have_text("\N{EN DASH}")
            page.get_by_role("button", name="OK").click()
            page.reload()
            expect(page.get_by_test_id("angle-0")).not_to_have_text("\N{EN DASH}")
            expect(page.get_by_text("was restarted")).to_have_count(0)
    finally:
        context.close()
