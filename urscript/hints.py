"""What somebody probably meant whose program does not compile: the habits of other languages, slips, lost ``end``s.

A hint is only ever added to an error. It explains, and decides nothing: which programs are refused, and at which
line a controller reports it, does not depend on this module.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from urscript.errors import Cause
from urscript.tokens import Token
from urscript.work import Steps

_COUNT: Final = "URScript has no 'for': count in a while loop"
_BRANCH: Final = "another branch begins with 'elif', and the last one with 'else:'"
_NO_TYPE: Final = "variables are not declared: write name = value"
_NO_SWITCH: Final = "URScript has no 'switch': use if and elif"
_NO_TRY: Final = "URScript has no exceptions: look at what a function returns"
_DEF: Final = "a function begins with 'def name(parameters):'"
_END: Final = "a block ends with 'end' alone"
END_WORDS: Final = frozenset(["endif", "endwhile", "endfor", "enddef", "endfunction", "End", "END", "fi", "done"])
_NO_IMPORT: Final = "URScript has no modules: all functions of a program are in its text"
_LOG: Final = 'textmsg("text") writes to the log'

_FIRST_WORDS: Final[Mapping[str, str]] = {
    **dict.fromkeys(["for", "foreach", "repeat", "do", "until", "loop"], _COUNT),
    **dict.fromkeys(["elseif", "elsif", "elsIf", "elseIf", "ElseIf", "Else", "ELSE"], _BRANCH),
    **dict.fromkeys(["var", "let", "const", "int", "float", "double", "bool", "string", "String", "auto"], _NO_TYPE),
    **dict.fromkeys(["switch", "case", "match"], _NO_SWITCH),
    **dict.fromkeys(["try", "except", "catch", "finally", "raise", "throw"], _NO_TRY),
    **dict.fromkeys(["function", "func", "fn", "sub", "proc", "void"], _DEF),
    **dict.fromkeys(END_WORDS, _END),
    **dict.fromkeys(["import", "include", "using", "from"], _NO_IMPORT),
    **dict.fromkeys(["print", "echo", "printf"], _LOG),
    "pass": "an empty block needs no statement",
    "If": "keywords are in small letters: if",
    "While": "keywords are in small letters: while",
    "Def": "keywords are in small letters: def",
    "goto": "URScript has no 'goto'",
    "class": "URScript has no classes; struct(name=value) holds values together",
}
"""First words of statements that are none."""

FOREIGN_BLOCKS: Final = frozenset(["for", "foreach", "switch", "match", "try", "function", "func"])
"""Of these, those that have a block."""

_BEFORE_BRACKETS: Final = frozenset(["for", "foreach", "switch", "match", "elseif", "elsif", "elseIf", "If", "While"])

_QUOTES: Final = 'texts stand between straight double quotes (")'
_AND: Final = "write 'and'"
_OR: Final = "write 'or'"
_COMMENT: Final = "a comment begins with '#'; floor(a / b) divides without remainder"
_COUNT_UP: Final = "write name = name + 1"
_COMPARE: Final = "'==' compares and '!=' tells whether values differ"
_SIGNS: Final[Mapping[str, str]] = {
    **{f"{sign}=": f"write name = name {sign} value" for sign in "+-*/%"},
    **dict.fromkeys(["++", "--"], _COUNT_UP),
    **dict.fromkeys(["//", "/*", "*/"], _COMMENT),
    **dict.fromkeys(["&&", "&"], _AND),
    **dict.fromkeys(["||", "|"], _OR),
    **dict.fromkeys(["===", "!==", "<>"], _COMPARE),
    **dict.fromkeys(["**", "^"], "write pow(base, exponent)"),
    "<-": "write name = value",
    ":=": "write name = value",
    ";": "statements end without ';': begin a new line",
    "'": _QUOTES,
    "`": _QUOTES,
    **dict.fromkeys("\u2018\u2019\u201a\u201c\u201d\u201e\u2033\u00ab\u00bb", _QUOTES),
    "{": "blocks begin with ':' and close with 'end'; lists have square brackets",
    "}": "blocks begin with ':' and close with 'end'; lists have square brackets",
    **dict.fromkeys("\u2013\u2014\u2212", "this is a dash: write the minus sign '-'"),
    "\u00d7": "write '*'",
    "\u00b0": "angles are in radians: d2r(90)",
    "\u00a0": "this is a non-breaking space: write a plain one",
    **dict.fromkeys(["{{", "{%", "{#"], "this is a template, whose values are not filled in"),
    "@": "URScript has no decorators",
    "?": "URScript has no conditional expression: use if",
}
"""Signs of other languages, by themselves or as they stand together."""

VARIABLES: Final[Mapping[str, str]] = {
    **dict.fromkeys(["true", "TRUE"], "write True"),
    **dict.fromkeys(["false", "FALSE"], "write False"),
    **dict.fromkeys(["null", "none", "nil", "NULL", "undefined", "nullptr"], "write None"),
    **dict.fromkeys(["pi", "PI", "math", "M_PI"], "URScript has no pi: d2r(180) gives it"),
}
"""Constants of other languages."""

_OF_ROBOTIQ: Final = (
    "it is defined by Robotiq's URCap, in the preamble that PolyScope puts before programs of its own and not before "
    "scripts that are sent: put the preamble of a saved .script before yours, or ask port 63352 by sockets"
)
_ROBOTIQ: Final = (  # as a preamble that the URCap wrote defines them
    *(
        "rq_activate",
        "rq_activate_and_wait",
        "rq_activate_all_grippers",
        "rq_reset",
        "rq_reset_and_activate",
        "rq_stop",
    ),
    *(
        "rq_open",
        "rq_open_and_wait",
        "rq_close",
        "rq_close_and_wait",
        "rq_wait",
        "rq_go_to",
        "rq_set_pos",
        "rq_set_sid",
    ),
    *("rq_move", "rq_move_norm", "rq_move_mm", "rq_move_and_wait", "rq_move_and_wait_norm", "rq_move_and_wait_mm"),
    *(
        "rq_set_force",
        "rq_set_force_norm",
        "rq_set_speed",
        "rq_set_speed_norm",
        "rq_set_pos_norm",
        "rq_set_pos_spd_for",
    ),
    *("rq_current_pos", "rq_current_pos_norm", "rq_current_pos_mm", "rq_motor_current", "rq_get_var", "rq_set_var"),
    *("rq_is_object_detected", "rq_is_motion_complete", "rq_is_gripper_activated", "rq_is_gripper_connected"),
    *("rq_wait_for_object_detected", "rq_auto_release_open_and_wait", "rq_auto_release_close_and_wait"),
    *("rq_init_connection", "rq_vacuum_grip", "rq_vacuum_release", "rq_print_gripper_fault_code"),
)

FUNCTIONS: Final[Mapping[str, str]] = {
    **dict.fromkeys(_ROBOTIQ, _OF_ROBOTIQ),
    **dict.fromkeys(["print", "printf", "println", "echo", "log_message", "textMsg", "disp"], _LOG),
    **dict.fromkeys(["len", "size_of", "sizeof", "count"], "length(list) gives the number of elements"),
    **dict.fromkeys(["abs", "fabs"], "norm(number) gives the absolute value"),
    **dict.fromkeys(["int", "trunc"], "floor(number) gives a whole number"),
    "round": "floor(number + 0.5) rounds",
    **dict.fromkeys(["str", "string", "String"], "to_str(value) gives a text"),
    **dict.fromkeys(["float", "double", "atof", "atoi"], 'to_num("text") reads a number'),
    **dict.fromkeys(["wait", "delay", "pause", "wait_time"], "sleep(seconds) waits"),
    **dict.fromkeys(["degrees", "rad2deg"], "r2d(angle) gives degrees"),
    **dict.fromkeys(["radians", "deg2rad", "rad"], "d2r(angle) gives radians"),
    **dict.fromkeys(["min", "max"], "compare with if"),
    **dict.fromkeys(["range", "enumerate"], _COUNT),
    **dict.fromkeys(["exit", "quit", "stop"], "'halt' ends the program"),
    **dict.fromkeys(["concat", "strcat", "str_concat"], "str_cat(a, b) joins texts"),
    **dict.fromkeys(["input", "raw_input"], "request_string_from_primary_client(text) asks the operator"),
    **dict.fromkeys(["mod", "fmod"], "write a % b"),
}
"""Functions of other languages, and of what is installed on other controllers."""


def syntax_hint(tokens: Sequence[Token], at: int, started: int) -> str:
    """What may be wrong where a text does not parse; empty when nothing comes to mind.

    at: number of the token that does not fit, started: of the first one of its statement.
    """
    token, first = tokens[at], tokens[min(started, at)]
    if first.kind == "name" and started < at and _begins_statement(first, tokens[started + 1]):
        return _FIRST_WORDS[first.text]
    if token.kind == "name" and token.text == "then":
        return "a condition ends with ':'"
    if token.kind == "if" and at > 0 and tokens[at - 1].kind == "else":
        return "write 'elif'"
    if token.kind == "=" and first.kind in ("if", "elif", "while"):
        return "'=' assigns, '==' compares"
    if token.kind == "==" and first.kind == "name":
        return "'==' compares, '=' assigns"
    if token.kind == "name" and token.text in ("is", "in"):
        return "'==' compares" if token.text == "is" else "URScript has no 'in'"
    signs = _signs_around(tokens, at)
    return _SIGNS.get(signs) or _SIGNS.get(token.text) or _SIGNS.get(token.text[:1], "")


def _begins_statement(word: Token, following: Token) -> bool:
    """Whether a word is the first of a statement that other languages have, and no variable or function here."""
    if word.text not in _FIRST_WORDS or following.kind in ("=", ".", "["):
        return False
    return following.kind != "(" or word.text in _BEFORE_BRACKETS


def _signs_around(tokens: Sequence[Token], at: int) -> str:
    """The signs that stand together with this one."""
    first = last = at
    while first > 0 and _is_sign(tokens[first - 1]) and _touch(tokens[first - 1], tokens[first]):
        first -= 1
    while last + 1 < len(tokens) and _is_sign(tokens[last + 1]) and _touch(tokens[last], tokens[last + 1]):
        last += 1
    return "".join(token.text for token in tokens[first : last + 1]) if _is_sign(tokens[at]) else ""


def _is_sign(token: Token) -> bool:
    return token.kind == "invalid" or (token.kind == token.text and not token.text[:1].isalpha())


def _touch(left: Token, right: Token) -> bool:
    return left.line == right.line and left.column + len(left.text) == right.column


# blocks and their ends

_WORK: Final = 1  # of a token whose indentation is looked at
_SLICE: Final = 50  # of these between two yields

_OPENING: Final = frozenset(["def", "sec", "thread", "if", "while"])
_BLOCK_WORDS: Final = _OPENING | {"for", "function", "switch", "else", "elif"}


def end_with_word(tokens: Sequence[Token], at: int) -> Cause:
    """What is wrong with the ``end if``, or its like, at a token."""
    word = tokens[at + 1]
    return Cause(word.line, word.column, f"{_END}, not 'end {word.text}'")


def is_end_with_word(tokens: Sequence[Token], at: int) -> bool:
    """Whether ``end if`` or its like stands there, and nothing behind it in its line."""
    end, word, after = (*tokens[at : at + 3], tokens[-1], tokens[-1])[:3]
    return (
        end.kind == "end"
        and word.text in _BLOCK_WORDS
        and word.line == end.line
        and (after.line > word.line or after.kind == "end of text")
    )


@dataclass(slots=True)
class _Block:
    opening: Token
    column: int  # of the first word of its line
    indented: bool | None = None  # what it holds, further than itself; None while that is not known


def unclosed_block(tokens: Sequence[Token]) -> Steps[Cause | None]:
    """By its indentation, the block whose ``end`` is missing."""
    found = yield from _by_indentation(tokens)
    if found is None or not found[2]:
        return None
    block, token, _ = found
    return Cause(
        block.line,
        block.column,
        f"the '{block.text}' of line {block.line} has no 'end', to judge by the indentation of line {token.line}",
    )


def misplaced_end(tokens: Sequence[Token]) -> Steps[Cause | None]:
    """By its indentation, the ``end`` that is one too many."""
    found = yield from _by_indentation(tokens)
    if found is None or found[2]:
        return None
    block, token, _ = found
    text = f"this 'end' closes the '{block.text}' of line {block.line}, and stands further right: one is too many"
    return Cause(token.line, token.column, text)


def _by_indentation(tokens: Sequence[Token]) -> Steps[tuple[Token, Token, bool] | None]:
    """The first block that does not end as its indentation shows, where that shows, and whether its end is missing."""
    blocks: list[_Block] = []
    line = column = 0
    for number, token in enumerate(tokens, 1):
        if number % _SLICE == 0:
            yield _SLICE * _WORK
        first = token.line > line
        if first:
            line, column = token.line, token.column
        block = blocks[-1] if blocks else None
        if first and block is not None and token.after_newline:
            if block.indented is None:
                block.indented = token.column > block.column or token.kind in ("end", "else", "elif")
            if _shows_a_missing_end(token, block, blocks[:-1]):
                return block.opening, token, True
            if token.kind == "end" and block.indented and token.column > block.column:
                return block.opening, token, False
        if token.kind in _OPENING:
            blocks.append(_Block(token, column))
        elif token.kind == "end" and blocks:
            blocks.pop()
    return None


def _shows_a_missing_end(token: Token, block: _Block, around: Sequence[_Block]) -> bool:
    if not block.indented or token.kind == "end of text":
        return False
    if token.kind in ("end", "else", "elif"):
        return token.column < block.column and any(outer.column == token.column for outer in around)
    return token.column <= block.column
