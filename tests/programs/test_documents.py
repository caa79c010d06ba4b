"""PolyScope's files are written in PolyScope's format after any change of their contents."""

import gzip
import re

import pytest

from tests.rows import each_row
from urscript.polyscope.document import (
    Changes,
    DocumentError,
    link,
    make,
    packed,
    read_document,
    sharing,
    unpacked,
    write_document,
)

SAMPLE = """<URProgram name="a &amp; b" installation="default">
  <children>
    <MainProgram runOnlyOnce="true" InitVariablesNode="false">
      <children>
        <Move motionType="MoveJ" speed="1.0471975511965976">
          <feature class="GeomFeatureReference" referencedName="Joint_0_name"/>
          <children>
            <Assignment valueSource="Expression">
              <variable name="x" prefersPersistentValue="false">
                <initializeExpression/>
              </variable>
              <expression>
                <ExpressionChar character="&quot;"/>
                <ExpressionChar character="&lt;"/>
                <ExpressionChar character="≟"/>
              </expression>
            </Assignment>
            <Assignment valueSource="Expression">
              <variable reference="../../Assignment/variable"/>
              <expression/>
            </Assignment>
          </children>
        </Move>
        <Move motionType="MoveL" speed="0.25">
          <feature class="GeomFeatureReference" reference="../../Move/feature"/>
          <children>
            <Force type="Frame">
              <feature reference="../../../../Move/feature"/>
            </Force>
            <Script type="File">
              <cachedContents>def f():
  textmsg(&quot;it&apos;s&quot;)
end
</cachedContents>
              <file>/programs/f.script</file>
            </Script>
            <Old>
              <commentString></commentString>
              <blank> </blank>
            </Old>
          </children>
        </Move>
      </children>
    </MainProgram>
    <Thread name="T" runOnlyOnce="false">
      <children>
        <CallSubProgram>
          <subprogram name="S" keepHidden="false">
            <children>
              <Comment comment="in it"/>
              <Wait type="Condition">
                <expression>
                  <ExpressionVariable>
                    <ProgramVariable reference="../../../../../../../../../MainProgram/children/Move/children/\
Assignment/variable"/>
                  </ExpressionVariable>
                </expression>
              </Wait>
            </children>
          </subprogram>
        </CallSubProgram>
      </children>
    </Thread>
    <SubProgram reference="../Thread/children/CallSubProgram/subprogram"/>
  </children>
</URProgram>""".encode()


def nodes(root, tag):
    return [place for place in root.places() if place.tag == tag]


def test_documents_round_trip_byte_for_byte():
    assert write_document(read_document(SAMPLE)) == SAMPLE
    again = read_document(packed(SAMPLE))
    assert write_document(again) == SAMPLE  # also if it is already linked
    assert write_document(again) == SAMPLE
    assert unpacked(packed(SAMPLE)) == gzip.decompress(packed(SAMPLE)) == SAMPLE


def test_a_changed_number_changes_only_its_own_bytes():
    root = read_document(SAMPLE)
    Changes().set_attribute(nodes(root, "Move")[1], "speed", "0.5")
    assert write_document(root) == SAMPLE.replace(b'speed="0.25"', b'speed="0.5"')


def test_an_object_moves_to_its_next_reference_when_its_first_is_removed():
    root = link(read_document(SAMPLE))
    first, second = nodes(root, "Move")
    holder = first.parent
    Changes().put(holder, "children", [second])
    text = write_document(root).decode()
    assert 'class="GeomFeatureReference" referencedName="Joint_0_name"' in text
    assert '<feature reference="../../../feature"/>' in text  # in the Force; the path has the class, not the object
    variable = re.search(r'<ProgramVariable name="x" prefersPersistentValue="false">', text)
    assert variable, text
    again = read_document(text.encode())
    assert nodes(again, "ProgramVariable")[0].get("name") == "x"
    assert nodes(again, "Force")[0].child("feature").get("referencedName") == "Joint_0_name"
    assert write_document(again).decode() == text


def test_references_follow_moved_objects():
    root = link(read_document(SAMPLE))
    first, second = nodes(root, "Move")
    Changes().put(first.parent, "children", [second, first])
    text = write_document(root).decode()
    assert text.index("Joint_0_name") < text.index("MoveJ")
    again = read_document(text.encode())
    assert [move.child("feature").get("referencedName") for move in nodes(again, "Move")] == ["Joint_0_name"] * 2
    assert 'reference="../../../../../../../../../MainProgram/children/Move[2]/children/Assignment/variable"' in text


def test_a_subprogram_whose_call_is_deleted_stays_in_the_program():
    root = link(read_document(SAMPLE))
    thread = nodes(root, "Thread")[0]
    Changes().put(thread.child("children"), "children", [])
    text = write_document(root).decode()
    assert '<SubProgram name="S" keepHidden="false">' in text
    assert 'reference="../../../../../../MainProgram/children/Move/children/Assignment/variable"' in text
    assert read_document(text.encode()).child("children").child("SubProgram").get("name") == "S"


def test_a_new_reference_shares_the_existing_object():
    root = link(read_document(SAMPLE))
    force = nodes(root, "Force")[0]
    Changes().set_child(force, "tcp", make("tcp", referencedName="Tool"))
    other = nodes(root, "Script")[0]
    Changes().set_child(other, "tcp", sharing("tcp", force.child("tcp")))
    assert b'<tcp reference="../../Force/tcp"/>' in write_document(root)


def test_changes_are_undone_exactly():
    root = link(read_document(SAMPLE))
    changes = Changes()
    move = nodes(root, "Move")[0]
    changes.set_attribute(move, "acceleration", "1.2", ("motionType", "acceleration", "speed"))
    changes.set_child(move, "tcp", make("tcp", referencedName="T"), ("tcp", "feature", "children"))
    changes.set_child(move, "feature", None)
    changes.set_text(nodes(root, "Script")[0], "file", "/programs/g.script")
    text = write_document(root).decode()
    assert '<Move motionType="MoveJ" acceleration="1.2" speed="1.0471975511965976">\n          <tcp' in text
    changes.undo()
    assert write_document(root) == SAMPLE


@each_row("text", ["tab\tend", "line\nend", "return\rend", "<&>'\"", "≟ é 漢 😀"])
def test_any_text_round_trips(text):
    root = make("a", make("b", text=f"x{text}"), c=text)
    again = read_document(write_document(root))
    assert again.get("c") == text
    assert again.child("b").text == f"x{text}"


@each_row("text", ["\x00", "\x1b[0m", "\udcff", "\ufffe"])
def test_values_that_xml_cannot_hold_are_refused(text):
    with pytest.raises(DocumentError, match="not allowed in XML"):
        write_document(make("a", b=text))


def test_unreadable_documents_are_not_written():
    root = inner = make("a")
    for _ in range(300):
        deeper = make("a")
        inner.children = [deeper]
        inner = deeper
    with pytest.raises(DocumentError, match="deep"):
        write_document(root)


@each_row("path", ["../c", "../b[7]", "../../../..", "../b[0]"])
def test_an_unresolvable_path_is_refused(path):
    with pytest.raises(DocumentError, match="which does not exist"):
        link(read_document(f'<a><b/><d reference="{path}"/></a>'.encode()))
