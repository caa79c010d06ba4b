"""Whether a saved script was generated from the program next to it: the statements of each node are compared.

Scripts of one program differ for other reasons, too: the language of the pendant, URCaps, step counters, how numbers
are written, and the statements of a Direction, which differ between versions. These do not count.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Final

from urproto.text import lines
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.document import Element
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.program import write_steps
from urscript.polyscope.tree import ProgramTree, tag_of
from urscript.polyscope.writer import ExternalControlCode
from urscript.work import run_to_end

_LABEL: Final = re.compile(r'\$ ([0-9]{1,9}) "')
_NUMBER: Final = re.compile(r"(?<![\w.])-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.])")
_SHOWN: Final = 80  # characters of a statement in a message
_BLANK: Final = re.compile(r"\s+")
_STRING: Final = re.compile(r'("[^"]*")')
_BEGIN, _END = "# begin: URCap", "# end: URCap"
_IGNORED: Final = ("step_count_", "#", "global _hidden_verificationVariable", "sync()", "end", "else:", "def ")
_DEFINED: Final = re.compile(r"(?:global )?(\w+_[pq])=(.*)")
_COMMENT: Final = re.compile(r"#[^\"]*$")
_UNSTABLE: Final = ("gui.program.direction.MoveDirectionNode", "Until")
_SETTINGS: Final = ("set_tcp", "set_target_payload", "set_payload", "set_gravity")


@dataclass(frozen=True, slots=True)
class Difference:
    """Statements of a node, or of the head of the program (number 0), that differ.

    number: the line of the node. expected: what the program says now. saved: what the script says.
    """

    number: int
    expected: str
    saved: str

    @property
    def message(self) -> str:
        """The difference for people."""
        return f"the saved script is from another state: it has {_shown(self.saved)}, not {_shown(self.expected)}"


def _shown(text: str) -> str:
    if not text:
        return "nothing"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def saved_in(root: Element) -> PolyscopeVersion:
    """The PolyScope version that last saved a program; the default version if the file does not say."""
    try:
        return PolyscopeVersion.parse(root.get("lastSavedIn"))
    except ValueError:
        return DEFAULT_VERSION[Series.CB3]


def stale_nodes(tree: ProgramTree, installation: InstallationFile, script: str) -> list[Difference]:
    """Where the script saved with a program differs from it. Raises TreeError if the program cannot be run."""
    none = ExternalControlCode("", "")
    writer = run_to_end(write_steps(tree, installation, version=saved_in(tree.root), external_control=none))
    unstable = {line.number for line in tree.lines if tag_of(line.element) in _UNSTABLE}
    found = script_differences(writer.text(), script)
    return [each for each in found if each.number not in unstable]


def script_differences(expected: str, saved: str) -> list[Difference]:
    """The nodes whose statements in a saved script differ from those of their program.

    Without labels in the script there is nothing to compare, and no difference.
    """
    first, second = _by_node(expected), _by_node(saved)
    if not second.keys() - {0}:
        return []
    found = []
    head = _settings(first.pop(0, [])), _settings(second.pop(0, []))
    found += [
        Difference(0, f"{name}={value}", f"{name}={head[1][name]}")
        for name, value in head[0].items()
        if head[1].get(name, value) != value
    ]
    for number in sorted(first.keys() | second.keys()):
        here, there = first.get(number, []), second.get(number, [])
        if here != there:
            found += [Difference(number, *pair) for pair in _first_difference(here, there)]
    return found


def _first_difference(here: Sequence[str], there: Sequence[str]) -> Iterator[tuple[str, str]]:
    for how, a, b, c, d in SequenceMatcher(None, here, there, autojunk=False).get_opcodes():
        if how != "equal":
            yield " ".join(here[a:b][:1]), " ".join(there[c:d][:1])
            return


def _by_node(script: str) -> dict[int, list[str]]:
    """The statements after each label, and before the first one."""
    found: dict[int, list[str]] = {0: []}
    number, urcap, branch = 0, 0, ""
    for line in lines(script):
        text = line.strip()
        urcap += text.startswith(_BEGIN)
        if (label := _LABEL.match(text)) is not None:
            number = int(label[1])
            found.setdefault(number, [])
            found[number] += [branch] if branch else []
            branch = ""
        elif number and text.startswith("elif"):  # before the label of its node; some versions write an If in the Else
            branch = _normal(_COMMENT.sub("", text.removeprefix("el")))
        elif not urcap and text and not text.startswith(_IGNORED):
            found[number].append(_normal(_COMMENT.sub("", text)))
        urcap -= _END in text and urcap > 0
    return found


def _normal(text: str) -> str:
    """A statement without blanks, its numbers with six decimals, so that the same value has the same text."""
    parts = _STRING.split(text)
    return "".join(
        part
        if index % 2
        else _BLANK.sub("", _NUMBER.sub(lambda match: f"{round(float(match[0]), 6) + 0.0:.10g}", part))
        for index, part in enumerate(parts)
    )


def _settings(head: Sequence[str]) -> dict[str, str]:
    """What the head of a script defines: positions, and the settings of the installation."""
    found = {}
    for text in head:
        name, bracket, rest = text.partition("(")
        if bracket and name in _SETTINGS:
            found[name] = rest
        elif match := _DEFINED.match(text.removeprefix("global")):
            found[match[1]] = match[2]
    return found
