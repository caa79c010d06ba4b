"""Syntax trees to text with no more brackets than needed, and to something that can be compared."""

from dataclasses import fields

from urscript.syntax import (
    Assign,
    Binary,
    Call,
    Constant,
    ExpressionStatement,
    FunctionDef,
    If,
    Index,
    Label,
    ListLiteral,
    Member,
    MethodCall,
    Name,
    Node,
    PoseLiteral,
    Return,
    Run,
    Scope,
    ThreadControl,
    Unary,
    While,
    Word,
)

# from the Script Manual's order of operations, not from the parser
LEVELS = [["or", "xor"], ["and"], ["not"], ["==", "!=", "<", ">", "<=", ">="], ["+", "-"], ["*", "/", "%"]]
LEVEL = {operator: level for level, operators in enumerate(LEVELS) for operator in operators}
SIGN = len(LEVELS)
ATOM = SIGN + 1


def expression(node: Node, least: int = 0) -> str:
    """The text of an expression, in brackets when it binds looser than `least`."""
    text, level = _expression(node)
    return f"({text})" if level < least else text


def _expression(node: Node) -> tuple[str, int]:
    match node:
        case Constant(value=value):
            text = f'"{value}"' if isinstance(value, str) else repr(value)
            return text, SIGN if text.startswith("-") else ATOM
        case Name(name=name):
            return name, ATOM
        case ListLiteral(items=items):
            return f"[{_items(items)}]", ATOM
        case PoseLiteral(items=items):
            return f"p[{_items(items)}]", ATOM
        case Unary(operator="not", operand=operand):
            return f"not {expression(operand, LEVEL['not'])}", LEVEL["not"]
        case Unary(operator=operator, operand=operand):
            return f"{operator}{expression(operand, SIGN)}", SIGN
        case Binary(operator=operator, left=left, right=right):
            level = LEVEL[operator]
            return f"{expression(left, level)} {operator} {expression(right, level + 1)}", level
        case Index(target=target, positions=positions):
            return f"{expression(target, ATOM)}[{_items(positions)}]", ATOM
        case Member(target=target, name=name):
            return f"{expression(target, ATOM)}.{name}", ATOM
        case MethodCall(target=target, name=name, arguments=arguments):
            return f"{expression(target, ATOM)}.{name}({_items(arguments)})", ATOM
        case Call(name=name, arguments=arguments, keywords=keywords):
            named = [f"{keyword}={expression(value)}" for keyword, value in keywords]
            return f"{name}({', '.join([*map(expression, arguments), *named])})", ATOM
        case Run(name=name):
            return f"run {name}()", SIGN  # neither called nor indexed
    raise AssertionError(node)


def _items(items: list[Node]) -> str:
    return ", ".join(map(expression, items))


def block(statements: list[Node]) -> str:
    return "".join(f"{statement(each)}\n" for each in statements)


def statement(node: Node) -> str:
    match node:
        case Assign(target=target, value=value):
            return f"{expression(target)} = {expression(value)}"
        case ExpressionStatement(value=value):
            return expression(value)
        case If(branches=branches, otherwise=otherwise):
            parts = [f"{expression(condition)}:\n{block(body)}" for condition, body in branches]
            return f"if {'elif '.join(parts)}{f'else:{chr(10)}{block(otherwise)}' if otherwise else ''}end"
        case While(condition=condition, body=body):
            return f"while {expression(condition)}:\n{block(body)}end"
        case Return(value=value):
            return "return" if value is None else f"return {expression(value)}"
        case Word(word=word):
            return word
        case ThreadControl(word=word, handle=handle):
            return f"{word} {expression(handle)}"
        case Label(number=number, text=text):
            return f'$ {number} "{text}"'
        case FunctionDef(scope=scope, body=body):
            parameters = [p.name + (f"={expression(p.default)}" if p.default else "") for p in scope.parameters]
            return f"{'thread' if scope.is_thread else 'def'} {scope.name}({', '.join(parameters)}):\n{block(body)}end"
    raise AssertionError(node)


def shape(tree: object) -> object:
    """What a tree says, without where it stands and what the parser found out about it."""
    if isinstance(tree, Scope):
        return ("thread" if tree.is_thread else "def", tree.name, shape(tree.parameters))
    if isinstance(tree, Node):
        names = [
            field.name for field in fields(tree) if field.name not in ("line", "column", "cost", "own_cost", "loops")
        ]
        return (type(tree).__name__, *(shape(getattr(tree, name)) for name in names))
    if isinstance(tree, list | tuple):
        return [shape(item) for item in tree]
    return repr(tree)
