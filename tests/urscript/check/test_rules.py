"""Every rule: a program that violates it, where, and one that does not although it resembles the first."""

from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript.check.checking import findings
from urscript.check.project import Project
from urscript.check.rules import RULES
from urscript.check.sources import sources_in

VERSION = PolyscopeVersion.parse("5.22")
POSES = "global a=p[0,0,0,0,0,0]\n global b=p[0.1,0,0,0,0,0]\n global c=p[0.2,0,0,0,0,0]\n"


def found(text: str, version: PolyscopeVersion = VERSION) -> list[tuple[str, int]]:
    sources = {version: sources_in("f.script", text.encode(), Project(), version)}
    return [(finding.code, finding.line) for finding in findings(sources, Project())]


def body(*lines: str) -> str:
    return "\n ".join(["def f():", *lines]) + "\nend\n"


def servo(line: str) -> str:
    return body("q = get_actual_joint_positions()", "while True:", "servoj(q, t=0.008)", line, "end")


# code, a text that violates the rule, the line, and texts that do not
CASES = [
    ("URS001", body("x = = 1"), 2, []),
    ("URS002", body("x = y"), 2, []),
    ("URS003", body("x = make_list(3, 0)"), 2, []),
    ("URS101", body("norm(1, 2)"), 2, []),
    ("URS102", body('sleep("1")'), 2, [body("sleep(1)")]),
    ("URS103", body('textmsg("a" + 1)'), 2, [body('textmsg("a" + "b")')]),
    ("URS104", body("movej([0, -90, 0, -90, 0, 0])"), 2, [body("movej([0, -1.57, 0, -1.57, 0, 0])")]),
    ("URS104", body("movel(p[0.1, 0, 0, 0, 0, 0], r=50)"), 2, [body("movel(p[0.1, 0, 0, 0, 0, 0], r=0.05)")]),
    ("URS105", body('socket_send_string("a\\n")'), 2, [body('socket_send_line("a")')]),
    ("URS106", body("x = [1]", "x.append(2)"), 3, []),
    (
        "URS107",
        body('popup("a\\nb", blocking=True)'),
        2,
        [body('x = socket_read_string(prefix="\\n", interpret_escape=True)', "textmsg(x)"), body('textmsg("a\\b")')],
    ),
    (
        "URS201",
        body("def g():", "sync()", "end", "sync()"),
        2,
        [body("def g():", "sync()", "end", "g()"), "def g(x):\n return x\nend\n", body('$ 1 "a"', "def g():", "end")],
    ),
    (
        "URS202",
        body("def g():", "x = 1", "sync()", "end", "g()"),
        3,
        [
            body("x = 1"),
            body("def g():", "x = 1", "return x", "end", "g()"),
            body("def g():", "x = random()", "end", "g()"),
        ],
    ),
    (
        "URS203",
        body("global x = 1", 'x = "a"'),
        3,
        [body("x = 1", "x = 1.5"), body("x = [1, 2]", "x = p[0,0,0,0,0,0]"), body("x = None", "x = 1")],
    ),
    (
        "URS204",
        body("def g(a):", "if a:", "x = 1", "end", "return x", "end", "g(True)"),
        6,
        [
            body("def g(a):", "if a:", "x = 1", "else:", "x = 2", "end", "return x", "end", "g(True)"),
            body("def g(a):", "if a:", "x = 1", "else:", "return 0", "end", "return x", "end", "g(True)"),
            body("def g(a):", "if a:", "x = 1", "end", "if a:", "return x", "end", "return 0", "end", "g(True)"),
            body("def g(a):", "if a:", "x = 1", "end", "if not a:", "x = 2", "end", "return x", "end", "g(True)"),
            body("def g(a):", "while a:", "x = 1", "end", "return x", "end", "g(True)"),
        ],
    ),
    (
        "URS301",
        body("while get_standard_digital_in(0) == False:", "end"),
        2,
        [
            body("while get_standard_digital_in(0) == False:", "sync()", "end"),
            body("i = 0", "while i < 9:", "i = i + 1", "end"),
            body("i = 0", "while True:", "i = i + 1", "if i > 9:", "break", "end", "end"),
            body("def g():", "sync()", "end", "while True:", "g()", "end"),
            body("def g():", "while True:", "return 1", "end", "end", "g()"),
            body("def g():", "return get_digital_in(0)", "end", "while g():", "end"),
        ],
    ),
    (
        "URS301",
        body("thread g():", "while True:", "if get_standard_digital_in(0):", "sync()", "end", "end", "end", "run g()"),
        3,
        [
            body("thread g():", "while True:", "if get_standard_digital_in(0):", "sync()", "else:", "sleep(1)", "end")
            + " end\n end\n run g()\nend\n"
        ],
    ),
    (
        "URS302",
        body("while True:", 'popup("a")', "sync()", "end"),
        3,
        [
            body("while True:", 'popup("a", blocking=True)', "end"),
            body("while True:", 'popup("a")', "sleep(5)", "end"),
            body("while True:", 'popup("a")', "break", "end"),
            body("while True:", "movej([0,0,0,0,0,0])", 'popup("a")', "end"),
        ],
    ),
    (
        "URS303",
        servo("sleep(0.5)"),
        5,
        [servo("sleep(0.002)"), servo("if force() > 9: stopj(2) sleep(1) end"), body("while True:", "sleep(1)", "end")],
    ),
    ("URS303", servo('x = socket_read_string("s")'), 5, [servo('x = socket_read_string("s", timeout=0.002)')]),
    (
        "URS304",
        body(POSES, "movel(a)", "movel(b, r=0.06)", "movel(c)"),
        7,
        [
            body(POSES, "movel(a)", "movel(b, r=0.04)", "movel(c)"),
            body(POSES, "movej(a)", "movej(b, r=0.06)", "movej(c)"),
            body(POSES, "movel(a)", "movel(get_target_tcp_pose(), r=0.06)", "movel(c)"),
        ],
    ),
]


@each_row(("code", "text", "line", "others"), CASES, ids=[f"{c[0]}-{n}" for n, c in enumerate(CASES)])
def test_a_rule_finds_its_mistake_and_nothing_like_it(code, text, line, others):
    version = PolyscopeVersion.parse("5.8") if code in ("URS003", "URS106") else VERSION
    assert (code, line) in found(text, version)
    for other in others:
        assert code not in dict(found(other, version)), other


def test_every_rule_has_a_case():
    # of program trees and of projects: test_context.py; of saved scripts: tests/programs/test_git.py
    elsewhere = {"URS004", "URS108", "URS205"}
    assert {case[0] for case in CASES} | elsewhere == set(RULES)
