"""What was recorded last: so that a message whose number is there already is told from one with other content."""

_MOST = 250_000  # of each generation, about 100 bytes each


class RecentMessages:
    """Digests of the messages that were recorded last, at least 250,000 of them if there were so many.

    The digests are those of this process: nobody else can make a message that has one of them.

    Examples
    --------
    >>> recent = RecentMessages()
    >>> recent.add(("k", "e"), 0, b"a")
    >>> recent.differs(("k", "e"), 0, b"a"), recent.differs(("k", "e"), 0, b"b"), recent.differs(("k", "e"), 7, b"b")
    (False, True, None)
    """

    def __init__(self, most: int = _MOST) -> None:
        self._most = most
        self._young: dict[int, int] = {}
        self._old: dict[int, int] = {}

    def add(self, stream: tuple[str, str], seq: int, payload: bytes) -> None:
        """Remember a message."""
        if len(self._young) >= self._most:
            self._old, self._young = self._young, {}
        self._young[hash((stream, seq))] = hash(payload)

    def differs(self, stream: tuple[str, str], seq: int, payload: bytes) -> bool | None:
        """Whether another message was recorded under that number; None where that is not known any more."""
        name = hash((stream, seq))
        found = self._young.get(name)
        if found is None:
            found = self._old.get(name)
        return None if found is None else found != hash(payload)
