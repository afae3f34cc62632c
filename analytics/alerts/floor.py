"""What goes on at the stations, followed from the log."""

from analytics.alerts.finding import UnitLife
from storage.log.follower import FollowedMessage
from stream.errors import GyrofleetError
from stream.events import AnyDocument, PowerOff, RunEnded, StepStarted, UnitReleased
from stream.wire.batches import RawBatch


class Floor:
    """The units and instruments of the runs that go on, by name; `commands_deg_c` are those of their steps, by run."""

    def __init__(self) -> None:
        self.units: dict[str, UnitLife] = {}
        self.commands_deg_c: dict[str, float] = {}

    def take(self, message: FollowedMessage) -> AnyDocument | None:
        """Take a message of the log; its document, if it is one."""
        content = message.content
        if isinstance(content, GyrofleetError):
            return None
        if isinstance(content, RawBatch):
            self._samples(content, message.record.arrival_ns)
            return None
        self._document(content)
        return content

    def _samples(self, raw: RawBatch, arrived_ns: int) -> None:
        head = raw.message
        life = self.units.get(head.unit)
        if life is None or life.run != head.run:
            life = self.units[head.unit] = UnitLife(head.run, arrived_ns)
        life.arrived_ns = max(life.arrived_ns, arrived_ns)
        if head.signal.endswith("temperature"):
            life.latest[head.signal] = float(raw.decoded().value_array[-1]), head.unit_of_measure

    def _document(self, document: AnyDocument) -> None:
        if isinstance(document, RunEnded):
            self.units = {name: life for name, life in self.units.items() if life.run != document.run}
            self.commands_deg_c.pop(document.run, None)
        elif isinstance(document, PowerOff | UnitReleased):
            self.units.pop(document.unit, None)  # what has no power, or is done, delivers nothing
        elif isinstance(document, StepStarted):
            self.commands_deg_c.pop(document.run, None)
            if (command := document.words.temperature_command_deg_c) is not None:
                self.commands_deg_c[document.run] = command
