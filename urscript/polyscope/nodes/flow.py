"""Branches, loops and timers."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.registry import node, translate_children
from urscript.polyscope.writer import Writer, expression_label, expression_text, variable_name
from urscript.work import Steps

_DEFAULT_CASE: Final = "2147483647"


@node("If")
def branch(writer: Writer, element: Element) -> Steps[None]:
    """If with the ElseIf and Else nodes behind it; the expression may be checked continuously."""
    if element.get("type") != "If":
        return  # written with its If
    yield from _branches(writer, [element, *_others(element)])


def _branches(writer: Writer, chain: list[Element]) -> Steps[None]:
    """Branches in their order. One that is left as soon as its expression is false leads on to the next, so those
    behind it lie in a branch of their own."""
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
    """The body is a thread, which is killed when the expression is false; its flag says how it ended."""
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


@node("Loop")
def loop(writer: Writer, element: Element) -> Steps[None]:
    """Repeat a number of times, for ever, or while an expression holds, which may be checked continuously."""
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
        raise DocumentError(f"a Loop of type {kind!r}, which is not known")


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


@node("Switch")
def switch(writer: Writer, element: Element) -> Steps[None]:
    """The case whose number the expression has."""
    cases = [child for child in element.child("children") or () if child.tag == "Case"]
    name = f"switch_{writer.count('switch')}"
    writer.label(element, f"Switch {expression_label(writer, element.child('expression'))}")
    writer.line(f"{name} = {expression_text(writer, element.child('expression'))}")
    default = [case for case in cases if case.get("caseValue") in ("", _DEFAULT_CASE)]
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


@node("Case")
def case(writer: Writer, element: Element) -> None:
    """A branch of a Switch, which writes it."""
    raise DocumentError("a Case outside a Switch")


@node("Timer")
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
    """See to it that the thread of all timers counts a Timer's variable, whose name is returned."""
    name = variable_name(element.child("variable"))
    if name not in writer.timers:
        writer.timers.append(name)
    return name
