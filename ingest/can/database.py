"""CAN databases (DBC and what else cantools reads): their messages and names."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ingest.can.frames import EXTENDED, arbitration_id, pgn_key
from ingest.can.summary import logged_by
from stream.bounds import MAX_NAME_CHARS
from stream.errors import BadInput
from stream.identity import cleaned_name

if TYPE_CHECKING:
    from cantools.database.can import Message


def load_database(path: Path) -> "list[Message]":
    """Messages of one database; raises BadInput if it cannot be read."""
    import cantools

    try:
        # real databases overlap signals and overrun messages here and there; that spoils no other signal
        with logged_by("cantools"):  # of names that occur twice, which are distinguished here
            database = cantools.database.load_file(path, strict=False, encoding=_encoding(path))
    except FileNotFoundError as error:
        raise BadInput(f"{path}: no such file; give a CAN database (.dbc)") from error
    except Exception as error:  # parsers raise whatever bad text leads to
        raise BadInput(_format_error(path, error)) from error
    if not isinstance(database, cantools.database.can.Database):
        raise BadInput(f"{path}: holds diagnostics, not messages; give a CAN database (.dbc)")
    return list(database.messages)


def _format_error(path: Path, error: Exception) -> str:
    """What is wrong with a database, where, and what to do about it, around the words of the parser."""
    from cantools.database.errors import UnsupportedDatabaseFormatError

    text = " ".join(str(error).split())
    line = re.search(r"\bline (\d+)", text)
    cause = getattr(error, "e_dbc", None)
    if isinstance(cause, KeyError):
        text = f"it uses {cause.args[0]}, which it does not define"
    elif ">>!<<" in text:
        text = f"the parser stopped at the mark >>!<<, {text}"
    is_database = isinstance(error, UnsupportedDatabaseFormatError)
    todo = "mend that, or export it again from the tool it comes from" if is_database else "give a CAN database (.dbc)"
    return f"{path}: {f'line {line[1]}: ' if line else ''}cannot be read as a CAN database ({text}); {todo}"


def _encoding(path: Path) -> str | None:
    """Databases are of Windows' code page by tradition (cantools' own choice), of UTF-8 more and more."""
    content = path.read_bytes()
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return None
    return "utf-8-sig" if content.startswith(b"\xef\xbb\xbf") else "utf-8"


def own_id(message: "Message") -> int:
    """Arbitration id of a message in the database."""
    return arbitration_id(message.frame_id, is_extended=bool(message.is_extended_frame))


def is_j1939(message: "Message") -> bool:
    """Whether a message is of J1939: known by its PGN, whatever priority and source address."""
    return message.protocol == "j1939" and bool(own_id(message) & EXTENDED)


def has_id(message: "Message", identifier: int) -> bool:
    """Whether a frame of this arbitration id is one of the message."""
    own = own_id(message)
    if own == identifier or not (identifier & EXTENDED and is_j1939(message)):
        return own == identifier
    return pgn_key(own) == pgn_key(identifier)


class MessageIndex:
    """Finds the message of an arbitration id, an exact match first; of several the first."""

    def __init__(self, messages: "Iterable[Message]") -> None:
        listed = list(messages)[::-1]
        self._exact = {own_id(each): each for each in listed}
        self._of_pgn = {pgn_key(own_id(each)): each for each in listed if is_j1939(each)}

    def find(self, identifier: int) -> "Message | None":
        """The message, None if there is none."""
        found = self._exact.get(identifier)
        if found is None and identifier & EXTENDED:
            return self._of_pgn.get(pgn_key(identifier))
        return found


def own_names(messages: "Sequence[Message]") -> dict[tuple[str, str], str]:
    """Name of every signal by message and signal: in lower case, `message.signal` if one occurs twice."""
    pairs = [(message.name, signal.name) for message in messages for signal in message.signals]
    often = Counter(signal.lower() for _, signal in pairs)
    names = {
        (message, signal): _clean(signal if often[signal.lower()] == 1 else f"{message}.{signal}").lower()
        for message, signal in pairs
    }
    # names that differ in nothing but case keep it
    again = Counter(names.values())
    return {pair: name if again[name] == 1 else _clean(f"{pair[0]}.{pair[1]}") for pair, name in names.items()}


def _clean(name: str) -> str:
    return cleaned_name(name)[:MAX_NAME_CHARS]
