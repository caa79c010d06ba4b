"""Addresses of this machine: which they are, and how it reaches servers that listen on all of them."""

from tests.rows import each_row
from urproto.addresses import is_loopback, local_address


@each_row(
    ("address", "here"),
    [
        ("127.0.0.1", True),
        ("127.3.4.5", True),
        ("::1", True),
        ("::ffff:127.0.0.1", True),
        ("localhost", True),
        ("10.0.0.2", False),
        ("0.0.0.0", False),
        ("::ffff:10.0.0.2", False),
        ("ur5", False),
    ],
)
def test_only_loopback_is_this_machine(address: str, here: bool) -> None:
    assert is_loopback(address) is here


@each_row(
    ("listens", "reached"), [("0.0.0.0", "127.0.0.1"), ("::", "::1"), ("", "127.0.0.1"), ("10.0.0.2", "10.0.0.2")]
)
def test_a_server_on_all_addresses_is_reached_on_loopback(listens: str, reached: str) -> None:
    assert local_address(listens) == reached
