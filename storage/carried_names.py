"""Files of a store that travel beside the segments: they are never changed once written."""

import re

_PART = r"[^\s/\\\x00-\x1f\x7f.][^\s/\\\x00-\x1f\x7f]{0,199}"
_FILE = re.compile(
    rf"(?:certificates/{_PART}\.(?:pdf|xml)|models/{_PART}/\d{{4,}}-[0-9a-f]{{8,64}}\.json|attestations/\d{{8}}\.json)"
)


def is_carried(name: str) -> bool:
    """Whether a name is that of a file that travels.

    >>> is_carried("models/FOG-1/0001-0123456789abcdef.json"), is_carried("models/../store.json")
    (True, False)
    """
    return _FILE.fullmatch(name) is not None
