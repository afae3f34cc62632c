"""Arguments of Python's public functions: one of another type is refused in a sentence that names it."""

from collections.abc import Iterable, Mapping
from os import PathLike, fspath

from stream.errors import BadInput


def text_of(value: object, name: str, expected: str = "a text is expected") -> str:
    """The value, which must be a text.

    >>> text_of(3, "unit")
    Traceback (most recent call last):
    stream.errors.BadInput: unit is 3: a text is expected
    """
    if not isinstance(value, str):
        raise BadInput(f"{name} is {value!r}: {expected}")
    if not value.isascii() and not _is_utf8(value):
        raise BadInput(f"{name} is {value!r}: half of a surrogate pair in it is no character")
    return str(value)  # NumPy has texts of its own


def _is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def optional_text(value: object, name: str) -> str | None:
    """The value, which must be a text or None."""
    return None if value is None else text_of(value, name, "a text is expected, or nothing")


def texts_of(value: object, name: str) -> tuple[str, ...]:
    """One text or several; none may be anything else.

    >>> texts_of("A-1", "unit"), texts_of(["A-1", "A-2"], "unit")
    (('A-1',), ('A-1', 'A-2'))
    """
    if isinstance(value, str):
        return (text_of(value, name),)
    expected = "a text is expected, or several; leave it out for all"
    if not isinstance(value, Iterable):
        raise BadInput(f"{name} is {value!r}: {expected}")
    return tuple(text_of(each, f"one {name}", expected) for each in value)


def path_of(value: object, name: str) -> str:
    """The value as the text of a path."""
    found = fspath(value) if isinstance(value, str | PathLike) else None
    path = text_of(value if found is None else found, name, "a path is expected, as a text or pathlib.Path")
    if "\0" in path:
        raise BadInput(f"{name} is {path!r}: no path has a null character")
    return path


def parameters_of(value: object) -> object:
    """The parameters of a statement, by name or in their order."""
    if value is None or isinstance(value, Mapping | list | tuple):
        return value
    raise BadInput(f"parameters is {value!r}: a dictionary for $name is expected, or a list for ?")
