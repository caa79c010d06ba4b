"""Hints for programs that do not compile: habits from other languages, typing mistakes, missing or extra ``end``s.

A hint is only ever appended to an error. This module decides neither which programs are refused nor at which line a
controller reports the error.
"""

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from urscript.errors import Cause
from urscript.tokens import Token
from urscript.work import Steps

_COUNT: Final = "URScript has no 'for': count in a while loop"
_BRANCH: Final = "write 'elif condition:' for another branch and 'else:' for the last one"
_NO_TYPE: Final = "variables need no declaration: write name = value"
_NO_SWITCH: Final = "URScript has no 'switch': use if and elif"
_NO_TRY: Final = "URScript has no exceptions: check the values that functions return"
_DEF: Final = "a function begins with 'def name(parameters):'"
_END: Final = "a block ends with 'end' alone"
END_WORDS: Final = frozenset(["endif", "endwhile", "endfor", "enddef", "endfunction", "End", "END", "fi", "done"])
_NO_IMPORT: Final = "URScript has no modules: a program must contain all its functions"
_LOG: Final = 'textmsg("text") writes to the log'

_BRANCHES: Final = ("else", "elif")
_LIKE: Final = 0.65  # ratio of `difflib` from which a word is taken for a misspelt keyword (a guess)

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
    "If": "keywords are lower case: if",
    "While": "keywords are lower case: while",
    "Def": "keywords are lower case: def",
    "goto": "URScript has no 'goto'",
    "class": "URScript has no classes; struct(name=value) groups values",
}
"""First words of statements in other languages, and of misspelt ones."""

FOREIGN_BLOCKS: Final = frozenset(["for", "foreach", "switch", "match", "try", "function", "func"])
"""Those of them that open a block."""

_BEFORE_BRACKETS: Final = frozenset(["for", "foreach", "switch", "match", "elseif", "elsif", "elseIf", "If", "While"])

_QUOTES: Final = 'strings are written in straight double quotes (")'
_AND: Final = "write 'and'"
_OR: Final = "write 'or'"
_COMMENT: Final = "a comment begins with '#'; floor(a / b) is integer division"
_COUNT_UP: Final = "write name = name + 1"
_COMPARE: Final = "write '==' for equal and '!=' for not equal"
_TEMPLATE: Final = "this is a template whose placeholders were not filled in"
SIGNS: Final[Mapping[str, str]] = {
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
    "{": "blocks begin with ':' and end with 'end'; lists use square brackets",
    "}": "blocks begin with ':' and end with 'end'; lists use square brackets",
    **dict.fromkeys("\u2013\u2014\u2212", "this is a dash: write the minus sign '-'"),
    "\u00d7": "write '*'",
    "\u00b0": "angles are in radians: d2r(90)",
    "\u00a0": "this is a non-breaking space: use a plain one",
    **dict.fromkeys(["{{", "{%", "{#"], _TEMPLATE),
    "@": "URScript has no decorators",
    "?": "URScript has no conditional expression: use if",
}
"""Operators and punctuation of other languages, single or adjacent."""

VARIABLES: Final[Mapping[str, str]] = {
    **dict.fromkeys(["true", "TRUE"], "write True"),
    **dict.fromkeys(["false", "FALSE"], "write False"),
    **dict.fromkeys(["null", "none", "nil", "NULL", "undefined", "nullptr"], "write None"),
    **dict.fromkeys(["pi", "PI", "math", "M_PI"], "URScript has no pi: use d2r(180)"),
}
"""Constants of other languages."""

_OF_ROBOTIQ: Final = (
    "it is defined by Robotiq's URCap in a preamble, which PolyScope adds to its own programs but not to scripts sent "
    "by a client: put the preamble of a saved .script before yours, or use sockets to talk to port 63352"
)

FUNCTIONS: Final[Mapping[str, str]] = {
    **dict.fromkeys(["print", "printf", "println", "echo", "log_message", "textMsg", "disp"], _LOG),
    **dict.fromkeys(["len", "size_of", "sizeof", "count"], "length(list) returns the number of elements"),
    **dict.fromkeys(["abs", "fabs"], "norm(number) returns the absolute value"),
    **dict.fromkeys(["int", "trunc"], "floor(number) returns an integer"),
    "round": "floor(number + 0.5) rounds",
    **dict.fromkeys(["str", "string", "String"], "to_str(value) converts to a string"),
    **dict.fromkeys(["float", "double", "atof", "atoi"], 'to_num("text") converts to a number'),
    **dict.fromkeys(["wait", "delay", "pause", "wait_time"], "sleep(seconds) waits"),
    **dict.fromkeys(["degrees", "rad2deg"], "r2d(angle) converts to degrees"),
    **dict.fromkeys(["radians", "deg2rad", "rad"], "d2r(angle) converts to radians"),
    **dict.fromkeys(["min", "max"], "compare with if"),
    **dict.fromkeys(["range", "enumerate"], _COUNT),
    **dict.fromkeys(["exit", "quit", "stop"], "'halt' ends the program"),
    **dict.fromkeys(["concat", "strcat", "str_concat"], "str_cat(a, b) joins strings"),
    **dict.fromkeys(["input", "raw_input"], "request_string_from_primary_client(text) asks the operator"),
    **dict.fromkeys(["mod", "fmod"], "write a % b"),
}
"""Functions of other languages."""


_LOOK_BACK: Final = 40
"""Tokens of a line that are searched for a ``return``, and most letters of a number in another base."""

_WORK: Final = 1  # to check the indentation of a token
_SLICE: Final = 50  # tokens between two yields
_OPENING: Final = frozenset(["def", "sec", "thread", "if", "while"])
_BLOCK_WORDS: Final = _OPENING | {"for", "function", "switch", "else", "elif"}
_MAX_CANDIDATES = 2000
"""Limit for the search for a similar name: the number of known names, and the length of the unknown one."""

_SIMILAR = 0.6  # ratio of `difflib`, from 0 to 1, above which a name counts as similar
_COMPARING_WORK = 3, 12  # to compare which letters two names have, and in which order
_COMPARED = 60  # work between two yields


def syntax_hint(tokens: Sequence[Token], at: int, started: int) -> str:
    """A hint on what may be wrong where a text does not parse; empty when there is none.

    at: index of the token that does not fit; started: index of the first token of its statement.
    """
    token, first = tokens[at], tokens[min(started, at)]
    if token.kind == ",":
        return _hint_on_a_comma(tokens, at, started)
    if token.text == "{" and [after.text for after in tokens[at + 2 : at + 3]] == ["}"]:
        return _TEMPLATE
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
    return SIGNS.get(signs) or SIGNS.get(token.text) or SIGNS.get(token.text[:1], "")


def _hint_on_a_comma(tokens: Sequence[Token], at: int, started: int) -> str:
    line = [token for token in tokens[max(at - _LOOK_BACK, 0) : at] if token.line == tokens[at].line]
    if started == at and any(token.kind == "return" for token in line):
        return "a function returns one value: return [a, b] returns a list"
    return "one variable can be assigned at a time" if started == at - 1 and tokens[started].kind == "name" else ""


def function_hint(name: str) -> str:
    """A hint for a function that neither the program nor the controller defines; empty when there is none."""
    return _OF_ROBOTIQ if name.startswith("rq_") else FUNCTIONS.get(name, "")


def joined_number(tokens: Sequence[Token], at: int, started: int) -> Cause | None:
    """The number that goes on with letters, as in ``0x1F``, if that is why the token at index `at` does not fit."""
    for after in {at, min(started, at)} - {0}:
        number, word = tokens[after - 1], tokens[after]
        if number.kind == "number" and word.kind == "name" and _adjacent(number, word):
            return Cause(number.line, number.column, _number_hint(number.text, word.text))
    return None


def _number_hint(digits: str, letters: str) -> str:
    base = {"x": 16, "b": 2, "o": 8}.get(letters[:1].lower(), 0)
    if digits == "0" and base and len(letters) <= _LOOK_BACK:
        try:
            return f"numbers are decimal in URScript: write {int(letters[1:], base)} for 0{letters}"
        except ValueError:
            pass
    return f"the number {digits[:20]} is followed by letters"


def line_without(what: str, tokens: Sequence[Token], at: int) -> Cause | None:
    """The end of the line before, when the token at index `at` shows that it lacks something, and is on a later one."""
    last, token = tokens[at - 1], tokens[at]
    line = last.line + last.text.count("\n")
    if at == 0 or token.line <= line:
        return None
    column = len(last.text) - last.text.rfind("\n") if "\n" in last.text else last.column + len(last.text)
    return Cause(line, column, f"line {line} ends without {what}")


def _begins_statement(word: Token, following: Token) -> bool:
    """Whether a word begins a statement of another language, and is not a variable or function of this program."""
    if word.text not in _FIRST_WORDS or following.kind in ("=", ".", "["):
        return False
    return following.kind != "(" or word.text in _BEFORE_BRACKETS


def _signs_around(tokens: Sequence[Token], at: int) -> str:
    """The operators and punctuation directly adjacent to this one, joined."""
    first = last = at
    while first > 0 and _is_sign(tokens[first - 1]) and _adjacent(tokens[first - 1], tokens[first]):
        first -= 1
    while last + 1 < len(tokens) and _is_sign(tokens[last + 1]) and _adjacent(tokens[last], tokens[last + 1]):
        last += 1
    return "".join(token.text for token in tokens[first : last + 1]) if _is_sign(tokens[at]) else ""


def _is_sign(token: Token) -> bool:
    return token.kind == "invalid" or (token.kind == token.text and not token.text[:1].isalpha())


def _adjacent(left: Token, right: Token) -> bool:
    return left.line == right.line and left.column + len(left.text) == right.column


# blocks and their ends


def end_with_word(tokens: Sequence[Token], at: int) -> Cause:
    """The cause to report for an ``end if``, ``end while`` or similar at a token."""
    word = tokens[at + 1]
    return Cause(word.line, word.column, f"{_END}, not 'end {word.text}'")


def is_end_with_word(tokens: Sequence[Token], at: int) -> bool:
    """Whether the token begins an ``end if``, ``end while`` or similar that is the last thing on its line."""
    end, word, after = (*tokens[at : at + 3], tokens[-1], tokens[-1])[:3]
    return (
        end.kind == "end"
        and word.text in _BLOCK_WORDS
        and word.line == end.line
        and (after.line > word.line or after.kind == "end of text")
    )


def is_like_end(tokens: Sequence[Token], at: int) -> bool:
    """Whether a name that is alone on its line is meant to be the ``end`` of a block."""
    word, first = tokens[at], at - 1
    if word.text in END_WORDS:
        return True
    while first > 0 and tokens[first - 1].line == tokens[at - 1].line and at - first < _LOOK_BACK:
        first -= 1
    return at > 0 and word.column < tokens[first].column and len(word.text) > 1 and _is_like("end", word.text)


def is_like_branch(word: str) -> bool:
    """Whether a word is meant to be ``else`` or ``elif``, or is the beginning of one."""
    known = _FIRST_WORDS.get(word) == _BRANCH
    return known or any(branch.startswith(word) or _is_like(branch, word) for branch in _BRANCHES)


def _is_like(keyword: str, word: str) -> bool:
    return len(word) <= 2 * len(keyword) and difflib.SequenceMatcher(None, keyword, word).ratio() > _LIKE


@dataclass(slots=True)
class _Block:
    opening: Token
    column: int  # of the first word of its line
    indented: bool | None = None  # its body is indented further than the block itself; None while not known
    shown: Token | None = None  # what shows that its end is missing, unless an end in its column follows


def unclosed_block(tokens: Sequence[Token]) -> Steps[Cause | None]:
    """The block whose ``end`` is missing, judging by the indentation."""
    found = yield from _by_indentation(tokens)
    if found is None or not found[2]:
        return None
    block, token, _ = found
    text = f"the '{block.text}' on line {block.line} has no 'end', judging by the indentation of line {token.line}"
    return Cause(token.line, token.column, text, opened=block.line)


def misplaced_end(tokens: Sequence[Token]) -> Steps[Cause | None]:
    """The surplus ``end``, judging by the indentation."""
    found = yield from _by_indentation(tokens)
    if found is None or found[2]:
        return None
    block, token, _ = found
    closes = f"this 'end' closes the '{block.text}' on line {block.line}"
    return Cause(token.line, token.column, f"{closes}, unlike the indentation: there is one 'end' too many")


def _by_indentation(tokens: Sequence[Token]) -> Steps[tuple[Token, Token, bool] | None]:
    """The first block that does not end where its indentation says, the token that shows it, and whether its ``end``
    is missing rather than surplus."""
    blocks: list[_Block] = []
    closed: tuple[Token, Token] | None = None  # the block that the line before has closed, and its end
    doubtful: list[tuple[int, Token, Token]] = []  # blocks that end in their column, after a line that says otherwise
    line = column = 0
    for number, token in enumerate(tokens, 1):
        if number % _SLICE == 0:
            yield _SLICE * _WORK
        first = token.line > line
        if first:
            if closed is not None and token.after_newline and token.column > closed[1].column:
                return *closed, False
            closed, line, column = None, token.line, token.column
        block = blocks[-1] if blocks else None
        if first and block is not None and token.after_newline:
            if block.indented is None:
                block.indented = token.column > block.column or token.kind in ("end", "else", "elif")
            if block.shown is None and _shows_a_missing_end(token, block, blocks[:-1]):
                block.shown = token
            if token.kind == "end" and block.indented and token.column > block.column:
                return block.opening, token, False
        if token.kind in _OPENING:
            blocks.append(_Block(token, column))
        elif token.kind == "end" and blocks:
            block = blocks.pop()
            if block.shown is not None and not (first and token.column == block.column):
                return block.opening, block.shown, True
            if block.shown is not None:
                doubtful.append((token.line - block.shown.line, block.opening, block.shown))
            closed = (block.opening, token) if first else None
    unclosed = [(block.opening, block.shown) for block in blocks if block.shown is not None]
    if blocks and not unclosed and doubtful:  # one of them has taken the end of a block around it: the longest
        unclosed = [max(doubtful)[1:]]
    return (*unclosed[-1], True) if unclosed else None


def _shows_a_missing_end(token: Token, block: _Block, around: Sequence[_Block]) -> bool:
    if not block.indented or token.kind == "end of text":
        return False
    if token.kind in ("end", "else", "elif"):
        return token.column < block.column and any(outer.column == token.column for outer in around)
    return token.column <= block.column


def closest_name(name: str, candidates: list[str]) -> Steps[str]:
    """The candidate that is most similar to an unknown name; empty if none is."""
    if len(name) > _MAX_CANDIDATES or len(candidates) > _MAX_CANDIDATES:
        return ""
    by_small_letters = {candidate.lower(): candidate for candidate in candidates}
    matcher = difflib.SequenceMatcher[str](b=name.lower())
    best, work = (_SIMILAR, ""), 0.0
    for candidate in by_small_letters:  # as `difflib.get_close_matches` does
        matcher.set_seq1(candidate)
        work += 0.5
        if matcher.real_quick_ratio() >= best[0]:
            work += _COMPARING_WORK[0]
            if matcher.quick_ratio() >= best[0]:
                work += _COMPARING_WORK[1]
                best = max(best, (matcher.ratio(), candidate))
        if work >= _COMPARED:
            yield round(work)
            work = 0.0
    return by_small_letters.get(best[1], "")
