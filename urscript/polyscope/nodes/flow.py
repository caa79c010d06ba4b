"""Branches, loops and timers."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.expressions import expression_shown, lacks_expression
from urscript.polyscope.forms import (
    attribute_boolean,
    attribute_choice,
    attribute_number,
    expression_field,
    of_type,
    titled,
    variable_field,
)
from urscript.polyscope.nodes.operator import variable_shown
from urscript.polyscope.registry import Kind, empty_children, node, translate_children
from urscript.polyscope.surroundings import Surroundings
from urscript.polyscope.writer import Writer, expression_label, expression_text, variable_name
from urscript.work import Steps

_DEFAULT_CASE: Final = "2147483647"
_CONTINUOUSLY: Final = attribute_boolean("continuously", "Check expression continuously", "checkContinuously")
_LOOPS: Final = {"Forever": "Always", "Counting": "A number of times", "While": "While an expression is true"}


def _lacks_expression(element: Element) -> str:
    return "its expression" if lacks_expression(element) else ""


def _branch(key: str, title: str, kind: str) -> Kind:
    def new(_: Surroundings) -> Element:
        return make("If", make("expression"), empty_children(), type=kind, checkContinuously="false")

    def shown(element: Element) -> str:
        return titled(title, expression_shown(element.child("expression")))

    is_else = kind == "Else"
    return Kind(
        key,
        title,
        "Advanced",
        (lambda _: title) if is_else else shown,
        new=new,
        fields=() if is_else else (expression_field("expression", "Expression"), _CONTINUOUSLY),
        stands="nodes" if kind == "If" else "if",
        contains="nodes",
        undefined=(lambda _: "") if is_else else _lacks_expression,
        matches=lambda element: element.get("type") == kind,
    )


@node(
    "If",
    _branch("if", "If", "If"),
    _branch("elseif", "ElseIf", "ElseIf"),
    _branch("else", "Else", "Else"),
    attributes="type checkContinuously",
    children="expression removedSiblings children",
)
def branch(writer: Writer, element: Element) -> Steps[None]:
    """If with the ElseIf and Else nodes that follow it; the expression may be checked continuously."""
    if element.get("type") != "If":
        return  # written with its If
    yield from _branches(writer, [element, *_others(element)])


def _branches(writer: Writer, chain: list[Element]) -> Steps[None]:
    """Write the branches in their order. A branch that is left as soon as its expression becomes false continues with
    the next one, so the branches after it are nested in a separate branch."""
    if _is_continuous(chain[0]):
        yield from _watched(writer, chain[0], chain[1:])
        return
    if chain[0].get("type") == "Else":
        writer.label(chain[0], "Else")
        yield from translate_children(writer, chain[0])
        return
    for index, part in enumerate(chain):
        if index and (_is_continuous(part) or part.get("type") == "Else"):
            writer.line("else:")
            with writer.indented():
                yield from _branches(writer, chain[index:])
            break
        expression = part.child("expression")
        label = f"{part.get('type')} {expression_label(writer, expression)}"
        if not index:
            writer.label(part, label)
        writer.line(f"{'elif' if index else 'if'} ({writer.condition(part, chain)}):")
        with writer.indented():
            if index:
                writer.label(part, label)
            yield from translate_children(writer, part)
    writer.line("end")


def _is_continuous(part: Element) -> bool:
    return part.get("checkContinuously") == "true"


def _others(element: Element) -> list[Element]:
    """The ElseIf and Else nodes that follow an If."""
    siblings = element.parent.children if element.parent else []
    found = []
    for sibling in siblings[siblings.index(element) + 1 :]:
        if sibling.tag == "SuppressedNode":
            continue
        if sibling.tag != "If" or sibling.get("type") == "If":
            break
        found.append(sibling)
    return found


def _watched(writer: Writer, part: Element, rest: list[Element]) -> Steps[None]:
    """Write the body as a thread, which is killed when the expression becomes false; a flag tells how it ended."""
    expression = expression_text(writer, part.child("expression"))
    number = writer.number(part)
    writer.label(part, f"{part.get('type')} {expression_label(writer, part.child('expression'))}")
    writer.line(f"global thread_flag_{number}=0")
    with writer.block(f"thread Thread_if_{number}():"):
        yield from translate_children(writer, part)
        writer.line(f"thread_flag_{number} = 1")
    writer.line(f"if ({expression}):")
    with writer.indented():
        writer.line(f"global thread_handler_{number}=run Thread_if_{number}()")
        with writer.block(f"while (thread_flag_{number} == 0):"):
            writer.line(f"if not({expression}):")
            with writer.indented():
                writer.line(f"kill thread_handler_{number}")
                writer.line(f"thread_flag_{number} = 2")
            writer.line("else:")
            with writer.indented():
                writer.line("sync()")
            writer.line("end")
    writer.line("else:")
    with writer.indented():
        writer.line(f"thread_flag_{number} = 2")
    writer.line("end")
    if rest:
        with writer.block(f"if (thread_flag_{number} == 2):"):
            yield from _branches(writer, rest)


def _choose_loop(element: Element, value: str, program: Surroundings) -> None:
    """Choose another type of loop, with the attributes and children that files have for it."""
    program.set_attribute(element, "type", value)
    program.set_attribute(element, "count", "3" if value == "Counting" else None)
    program.set_attribute(element, "checkContinuously", "false" if value == "While" else None)
    program.set_child(element, "expression", make("expression") if value == "While" else None)
    variable = None
    if value == "Counting":
        variable = program.variable(program.unused("Loop", program.variables()), "loopVariable")
    program.set_child(element, "loopVariable", variable)


def _loop_shown(element: Element) -> str:
    if element.get("type") == "Counting":
        return f"Loop {element.get('count')} times"
    shown = expression_shown(element.child("expression")) if element.get("type") == "While" else ""
    return titled("Loop", shown)


def _loop_lacks(element: Element) -> str:
    kind = element.get("type")
    if kind == "While":
        return _lacks_expression(element)
    return "the variable that counts" if kind == "Counting" and element.child("loopVariable") is None else ""


LOOP: Final = Kind(
    "loop",
    "Loop",
    "Advanced",
    _loop_shown,
    new=lambda _: make("Loop", empty_children(), type="Forever"),
    contains="nodes",
    undefined=_loop_lacks,
    fields=(
        attribute_choice("type", "Loop", "type", _LOOPS, _choose_loop),
        attribute_number("count", "Times", "count", whole=True, low=0, high=2147483647, shown=of_type("Counting")),
        variable_field("variable", "Counts in", "loopVariable", shown=of_type("Counting")),
        expression_field("expression", "Expression", shown=of_type("While")),
        attribute_boolean("continuously", "Check expression continuously", "checkContinuously", shown=of_type("While")),
    ),
)


@node("Loop", LOOP, attributes="type checkContinuously count", children="loopVariable expression children")
def loop(writer: Writer, element: Element) -> Steps[None]:
    """Repeat a number of times, forever, or while an expression is true, which may be checked continuously."""
    kind = element.get("type")
    if kind == "Counting":
        yield from _counting(writer, element)
    elif kind == "Forever":
        writer.label(element, "Loop")
        with writer.block("while (True):"):
            yield from translate_children(writer, element)
    elif kind == "While":
        yield from _while(writer, element)
    else:
        raise DocumentError(f"a Loop of unknown type {kind!r}")


def _counting(writer: Writer, element: Element) -> Steps[None]:
    variable = variable_name(element.child("loopVariable"))
    writer.label(element, f"Loop {element.get('count')} times")
    writer.line(f"{variable} = 0")
    with writer.block(f"while ({variable} < {element.get('count')}):"):
        yield from translate_children(writer, element)
        writer.line(f"{variable} = {variable} + 1")


def _while(writer: Writer, element: Element) -> Steps[None]:
    expression = expression_text(writer, element.child("expression"))
    writer.label(element, f"Loop {expression_label(writer, element.child('expression'))}")
    if element.get("checkContinuously") != "true":
        with writer.block(f"while ({writer.condition(element)}):"):
            yield from translate_children(writer, element)
        return
    number = writer.number(element)
    with writer.block(f"thread Thread_while_{number}():"), writer.block("while (True):"):
        yield from translate_children(writer, element)
    with writer.block(f"if ({expression}):"):
        writer.line(f"global thread_handler_{number}=run Thread_while_{number}()")
        with writer.block(f"while ({expression}):"):
            writer.line("sync()")
        writer.line(f"kill thread_handler_{number}")


SWITCH: Final = Kind(
    "switch",
    "Switch",
    "Advanced",
    lambda element: titled("Switch", expression_shown(element.child("expression"))),
    new=lambda program: make("Switch", make("expression"), make("children", _new_case(program))),
    contains="switch",
    undefined=_lacks_expression,
    fields=(expression_field("expression", "Expression"),),
)


def _new_case(_: Surroundings) -> Element:
    return make("Case", empty_children(), caseValue="0")


def _is_default(element: Element) -> bool:
    return element.get("caseValue") in ("", _DEFAULT_CASE)


CASE: Final = Kind(
    "case",
    "Case",
    "Advanced",
    lambda element: f"Case {element.get('caseValue')}",
    new=_new_case,
    stands="switch",
    contains="nodes",
    matches=lambda element: not _is_default(element),
    fields=(attribute_number("value", "Value", "caseValue", whole=True, low=-2147483648, high=2147483646),),
)
DEFAULT: Final = Kind(
    "default_case",
    "Default Case",
    "Advanced",
    lambda _: "Default Case",
    new=lambda _: make("Case", empty_children(), caseValue=_DEFAULT_CASE),
    stands="switch",
    contains="nodes",
    matches=_is_default,
)


@node("Switch", SWITCH, children="expression children")
def switch(writer: Writer, element: Element) -> Steps[None]:
    """Run the case whose number equals the expression."""
    cases = [child for child in element.child("children") or () if child.tag == "Case"]
    name = f"switch_{writer.count('switch')}"
    writer.label(element, f"Switch {expression_label(writer, element.child('expression'))}")
    writer.line(f"{name} = {expression_text(writer, element.child('expression'))}")
    default = [case for case in cases if _is_default(case)]
    numbered = [case for case in cases if case not in default]
    for index, case in enumerate(numbered):
        writer.line(f"{'elif' if index else 'if'} ({case.get('caseValue')} == {name}):")
        with writer.indented():
            writer.label(case, f"Case {case.get('caseValue')}")
            yield from translate_children(writer, case)
    if default and numbered:
        writer.line("else:")
        with writer.indented():
            yield from _default_case(writer, default[0])
    if numbered:
        writer.line("end")
    elif default:
        yield from _default_case(writer, default[0])


def _default_case(writer: Writer, case: Element) -> Steps[None]:
    writer.label(case, "Default Case")
    yield from translate_children(writer, case)


@node("Case", CASE, DEFAULT)
def case(writer: Writer, element: Element) -> None:
    """Branch of a Switch, which writes it."""
    raise DocumentError("a Case outside a Switch")


def _new_timer(program: Surroundings) -> Element:
    return make("Timer", program.variable(program.unused("timer", program.variables())), action="Start")


TIMER: Final = Kind(
    "timer",
    "Timer",
    "Advanced",
    lambda element: f"{variable_shown(element.child('variable'))}: {element.get('action')}",
    new=_new_timer,
    undefined=lambda element: "" if element.child("variable") else "the variable that counts",
    fields=(
        variable_field("variable", "Variable"),
        attribute_choice("action", "Action", "action", {"Start": "Start", "Stop": "Stop", "Reset": "Reset"}),
    ),
)


@node("Timer", TIMER)
def timer(writer: Writer, element: Element) -> None:
    """Start, stop or reset a variable that counts seconds."""
    name = count_time(writer, element)
    action = element.get("action")
    writer.label(element, f"{name}: {action}")
    if action in ("Start", "Stop"):
        writer.line(f"{name}_is_counting = {action == 'Start'}")
    elif action == "Reset":
        writer.line(f"{name} = 0")
    else:
        raise DocumentError(f"a Timer has no action {action!r}")


def count_time(writer: Writer, element: Element) -> str:
    """Make the thread of all timers count a Timer's variable; returns its name."""
    name = variable_name(element.child("variable"))
    if name not in writer.timers:
        writer.timers.append(name)
    return name
