"""Rules on texts."""

from collections.abc import Iterator

from urscript.check.rules.registry import body_rule
from urscript.check.subject import Body, Subject, inner, own_expressions
from urscript.literals import ESCAPE, SENDING
from urscript.syntax import Call, Constant, Node, all_statements

_INTERPRETING = "interpret_escape"  # the argument of socket_read_string that makes it look for escapes


@body_rule("URS107", "shown-escape")
def escapes(_: Subject, body: Body) -> Iterator[tuple[Node, str]]:
    """a text that is shown or kept contains \\n, \\r or \\t: the backslash and the letter stay in it"""
    for statement in all_statements(body.statements):
        skipped: set[int] = set()
        for node in inner(own_expressions(statement)):
            if isinstance(node, Call) and (
                node.name in SENDING or any(name == _INTERPRETING for name, _ in node.keywords)
            ):
                skipped.update(id(part) for part in inner([node]))
            text = node.value if isinstance(node, Constant) and id(node) not in skipped else None
            if isinstance(text, str) and ESCAPE.search(text):
                yield node, "URScript has no escapes: the backslash and the letter after it stay in the text"
