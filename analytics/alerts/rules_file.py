"""The file of rules while the alerts are watched: read again when it changes, as it was while it is wrong."""

from pathlib import Path

from analytics.alerts.rules import Rules, load_rules
from stream.errors import BadInput


class RulesFile:
    """The rules of a file, checked with what their targets need; raises BadInput if they are wrong at first."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._state, self._problem = self._stat(), ""
        self.rules = self._read()

    def look(self) -> str:
        """Read the file again if it has changed; what is wrong with it, empty if nothing."""
        state = self._stat()
        if state != self._state:
            self._state = state
            try:
                rules = self._read()
            except BadInput as error:
                self._problem = f"{error}; the rules stay as they were before"
            else:
                self.rules, self._problem = rules, ""
        return self._problem

    def _read(self) -> Rules:
        rules = load_rules(self.path)
        for target in rules.targets.values():
            target.check()
        return rules

    def _stat(self) -> tuple[int, ...] | None:
        try:
            found = self.path.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino
