"""The sources of a station: its buses, serial lines and instruments, each delivering batches of samples."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from uuid import uuid4

from ingest.can.bus.bus import BLOCK_S, CanBus
from ingest.can.bus.columns import ReceiveClock
from ingest.can.bus.interface import open_intake
from ingest.can.mapping import CanMapping
from ingest.can.plan import CanPlan
from ingest.can.stream import CanDecoder
from ingest.can.summary import MessageCount
from ingest.instruments.base import Instrument
from ingest.serial.frame_layout import FrameLayout, load_layout
from ingest.serial.serial_line import BATCH_S, SerialLine, open_port
from ingest.station.checks.room import Flow
from ingest.station.run_log import RunLog
from ingest.station.sampling import BATCH_S as INSTRUMENT_BATCH_S
from ingest.station.sampling import Sampler
from ingest.station.serial_devices import SerialDevices
from ingest.station.source_watch import RunSource
from ingest.station.station import Station
from ingest.station_clock import StationClock
from stream.errors import BadInput, InstrumentError
from stream.quantities import is_angular_rate
from stream.worker.estimated_signals import EstimatedSignals


class StationSources:
    """Makes the sources of a run for the tested units; raises BadInput if one has none, or two.

    A mapping, database or layout that is unusable is among what `cannot_be_opened` has: then nothing can be made.
    """

    def __init__(
        self, station: Station, instruments: Mapping[str, Instrument], clock: StationClock, units: tuple[str, ...]
    ) -> None:
        self._station, self._instruments, self._clock = station, instruments, clock
        self._units, self._epoch = frozenset(units), uuid4()
        self._lines = {name: line for name, line in station.lines.items() if line.unit in self._units}
        self._plans: dict[str, CanPlan] = {}
        self._layouts: dict[str, FrameLayout] = {}
        self._faults: list[str] = []
        for name, bus in station.buses.items():
            with self._fault():
                plan = CanMapping(list(map(station.beside, bus.dbc)), station.beside(bus.mapping)).plan()
                mine = tuple(route for route in plan.routes if route.unit in self._units)
                self._plans[name] = CanPlan(mine, plan.remarks)
        for name, line in station.lines.items():
            with self._fault():
                self._layouts[name] = load_layout(station.beside(line.layout))
        self._check_twice()
        SerialDevices().add(station, self._lines)  # a unit that is not tested takes nothing
        known = {unit for plan in self._plans.values() for unit in plan.units}
        known |= {line.unit for line in station.lines.values()}
        if (strangers := sorted(self._units - known)) and len(self._plans) == len(station.buses):
            raise BadInput(
                f"no bus or line of station {station.table.name} ({station.path}) has unit {', '.join(strangers)}: add "
                f"it to a mapping file, or take it out of --units"
            )
        if taken := sorted(self._units & set(instruments)):
            raise BadInput(f"{', '.join(taken)}: a unit and an instrument of {station.path} have the same name")

    @contextmanager
    def _fault(self) -> Iterator[None]:
        """Note that a file is unusable, once."""
        try:
            yield
        except BadInput as error:
            self._faults += [str(error)] * (str(error) not in self._faults)

    def remark_on(self, estimated: EstimatedSignals) -> str | None:
        """What to say of signals that are to be estimated, and that nothing of the station delivers."""
        known = {signal for _, signal, _ in self._delivered()}
        known |= {signal for instrument in self._instruments.values() for signal in instrument.signals}
        return estimated.remark_on(known)

    def _delivered(self) -> list[tuple[str, str, str]]:
        """Unit, name and unit of measure of the signals of units."""
        came = [signal for plan in self._plans.values() for signal in plan.signals]
        for name, line in self._lines.items():
            came += [(line.unit, field.signal, field.unit) for field in self._layouts[name].fields]
        return came

    def flows(self) -> Iterator[Flow]:
        """What comes from units and instruments, as mappings, databases, layouts and the station's file state it."""
        of_computer_s = self._clock.speed
        for plan in self._plans.values():
            for message in (route.message for route in plan.routes):
                interval_s = (message.interval_ns or message.cycle_ns) / 1e9 or None
                for is_counts in (True, False):
                    signals = sum(each.is_counts == is_counts for each in message.signals)
                    yield Flow(signals, interval_s, BLOCK_S * of_computer_s, is_counts)
        for name in self._lines:
            layout = self._layouts[name]
            yield Flow(len(layout.fields), layout.interval_s, BATCH_S * of_computer_s)
        for each in self._instruments.values():
            interval_s = float(each.options.sample_interval_s)
            yield Flow(len(each.signals), interval_s, INSTRUMENT_BATCH_S * of_computer_s, is_counts=False)

    def rate_signals(self) -> dict[str, list[str]]:
        """Angular rates that each unit delivers."""
        found: dict[str, list[str]] = {unit: [] for unit in sorted(self._units)}
        for unit, signal, unit_of_measure in self._delivered():
            if unit in found and is_angular_rate(unit_of_measure):
                found[unit].append(signal)
        return found

    def _check_twice(self) -> None:
        """Refuse a signal that has two sources: its samples could not be numbered."""
        ways: dict[tuple[str, str], str] = {}
        found = [(f"buses.{name}", *signal[:2]) for name, plan in self._plans.items() for signal in plan.signals]
        found += [(f"lines.{name}", line.unit, "") for name, line in self._lines.items()]
        for way, unit, signal in found:
            if (other := ways.setdefault((unit, signal), way)) != way:
                what = f"signal {signal} of unit {unit}" if signal else f"unit {unit}"
                twice = f"{what} comes from {other} and from {way} as well"
                raise BadInput(f"{self._station.path}: {twice}: take it out of one")

    def cannot_be_opened(self) -> list[str]:
        """A sentence for each file that is unusable, and each bus and line that cannot be opened now."""
        found = list(self._faults)
        for name in self._plans:
            try:
                open_intake(self._station.buses[name].bus, ReceiveClock(self._clock, lambda _: None))[0].close()
            except InstrumentError as error:
                found.append(f"buses.{name} of {self._station.path}: {error}")
        for name, line in self._lines.items():
            try:
                open_port(line.port, line.baud, self._layouts.get(name), f"unit {line.unit} at {line.port}").close()
            except InstrumentError as error:
                found.append(f"lines.{name} of {self._station.path}: {error}")
        return found

    def make(self, log: RunLog, report: Callable[[str], None]) -> list[RunSource]:
        """Sources for the present power-ons, of the tested units only."""
        made: list[RunSource] = []
        run = log.state.run
        for name, plan in self._plans.items():
            decoder = CanDecoder(plan, run=run, epoch_of=log.epoch_of, is_live=self._clock.speed == 1.0)
            options = self._station.buses[name].bus
            made.append(
                CanBus(
                    options, self._clock, decoder, log.deliver, report, wanted=plan.wanted,
                    frame_counts=partial(_messages, decoder), mapping=str(self._station.buses[name].mapping),
                )
            )  # fmt: skip
        for name, line in self._lines.items():
            layout, unit, epoch = self._layouts[name], line.unit, log.epoch_of(line.unit)
            made.append(
                SerialLine(
                    line.port, line.baud, layout, unit, run, epoch, self._clock, log.deliver, report,
                    layout_name=str(line.layout),
                )
            )  # fmt: skip
        return made

    def samplers(self, log: RunLog, report: Callable[[str], None]) -> list[RunSource]:
        """Samplers of all instruments."""
        return [
            Sampler(instrument, log.state.run, self._epoch, log.deliver, report)
            for instrument in self._instruments.values()
            if instrument.signals
        ]


def _messages(decoder: CanDecoder) -> Iterable[MessageCount]:
    return decoder.counts.messages
