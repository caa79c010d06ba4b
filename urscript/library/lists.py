"""Lists: their length, and creating a list of a given size."""

from urproto.text import to_bytes
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.operators import check_size, whole
from urscript.values import MAX_ELEMENTS, Any_, Int, Matrix, Struct, Value, list_with_capacity, type_name

LIBRARY = Library("lists")


def _length(name: str, value: Value) -> int:
    if isinstance(value, list):
        return len(value)
    if isinstance(value, str):
        charge(len(value) // 16)
        return len(to_bytes(value))
    if isinstance(value, Matrix):
        return len(value.rows)
    raise RuntimeFault(f"Type error: {name} expected type 'List' but found '{type_name(value)}'")


@LIBRARY.builtin()
def get_list_length(v: Any_) -> int:
    """Number of elements of a list or pose, bytes of a string, rows of a matrix."""
    return _length("get_list_length", v)


@LIBRARY.builtin()
def length(v: Any_) -> int:
    """Number of elements of a list or pose, bytes of a string, rows of a matrix."""
    return _length("length", v)


@LIBRARY.builtin(cb3=None, e="5.15")  # vendor's forum, thread 30144
def make_list(length: Int, initial_value: Any_, capacity: Int | None = None) -> list[Value]:
    """A list of `length` times `initial_value` that can grow to `capacity` elements (default: `length`)."""
    room = length if capacity is None else whole(capacity, "capacity")
    if not 0 <= length <= room <= MAX_ELEMENTS:
        required = f"0 <= length <= capacity <= {MAX_ELEMENTS} is required"
        raise RuntimeFault(f"make_list: {required}, but length is {length} and capacity {room}")
    if isinstance(initial_value, (list, Matrix, Struct)):
        check_size([initial_value] * length)
    charge(length)
    return list_with_capacity([initial_value] * length, room)
