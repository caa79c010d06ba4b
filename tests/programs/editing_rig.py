"""Programs for editing, and their contents."""

from typing import Any

from urproto.robots import load_model
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.polyscope.document import Element, read_document, write_document
from urscript.polyscope.editing import ProgramEditor
from urscript.polyscope.files import new_program
from urscript.polyscope.installation_file import InstallationFile, PayloadSetting

E_SERIES, CB3 = DEFAULT_VERSION[Series.E], DEFAULT_VERSION[Series.CB3]
ZERO = (0.0,) * 6
HOME = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
INSTALLATION = InstallationFile(
    name="cell",
    tcp=ZERO,
    tcps={"TCP": ZERO, "gripper": (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)},
    payloads={"part": PayloadSetting(1.0)},
    features={"table": (0.1, 0.2, 0.3, 0.0, 0.0, 0.0)},
    feature_variables=frozenset({"table"}),
    pins={"clamp": ("digital_out", "3"), "part_there": ("digital_in", "2")},
    variables={"kept": "1"},
    home=HOME,
)


def editor(version: PolyscopeVersion = E_SERIES, **options: Any) -> ProgramEditor:
    """An empty program, for a UR5e or a UR5."""
    arm = load_model("ur5e" if version.series is Series.E else "ur5")
    return ProgramEditor(new_program("made", version, arm, **options), "made", INSTALLATION, version, arm)


def reopened(edited: ProgramEditor) -> ProgramEditor:
    """The program after saving and reading."""
    root = read_document(edited.document())
    return ProgramEditor(root, edited.name, edited.installation, edited.version, edited.program.model)


def id_of(edited: ProgramEditor, kind: str) -> str:
    """The first node of a kind."""
    return next(row.id for row in edited.rows() if row.kind == kind)


def outline(edited: ProgramEditor) -> list[tuple[Any, ...]]:
    """The tree without the ids."""
    return [(row.number, row.depth, row.title, row.kind, row.suppressed, row.defined) for row in edited.rows()]


def element(text: str) -> Element:
    """A document from its text."""
    root = read_document(text.encode())
    assert write_document(root).decode() == text
    return root
