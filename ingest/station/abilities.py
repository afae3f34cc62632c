"""Whether a station can do a procedure: what it can set, how far, and whether it can switch the units."""

from collections.abc import Mapping

from ingest.instruments.base import Instrument
from ingest.instruments.scpi_instrument import ScpiInstrument
from ingest.procedures.procedure import Procedure
from ingest.station.bench import StationBench
from ingest.station.station import Station
from stream.errors import BadInput


def check_station(station: Station, procedure: Procedure, parameters: Mapping[str, str]) -> None:
    """Raise BadInput where a station lacks what a procedure sets or switches."""
    lacking = [each for each in procedure.requirements(parameters) if each.setting not in station.settings]
    if lacking:
        wants = "; ".join(f"{each.setting} from {each.least:g} to {each.most:g} {each.unit}" for each in lacking)
        raise BadInput(
            f"station {station.table.name} ({station.path}) cannot do procedure {procedure.name}: it has no instrument "
            f"for {wants}; it can set {', '.join(sorted(station.settings)) or 'nothing'}"
        )


def check_limits(
    station: Station, instruments: Mapping[str, Instrument], procedure: Procedure, parameters: Mapping[str, str]
) -> None:
    """Raise BadInput where a procedure exceeds an instrument's range, or switches power without a supply."""
    for each in procedure.requirements(parameters):
        name = station.settings[each.setting]
        instrument = instruments[name]
        if not isinstance(instrument, ScpiInstrument):
            continue
        low, high = instrument.limits(each.setting)
        if not low <= each.least <= each.most <= high:
            raise BadInput(
                f"procedure {procedure.name} sets a {each.setting} of {each.least:g} to {each.most:g} {each.unit}, and "
                f"instruments.{name} of {station.path} may be set to {low:g} to {high:g} {each.unit}: choose other "
                f"values with --set, or another station"
            )
    switches = any(step.power is not None for step in procedure.steps(parameters))
    if switches and not StationBench(station, instruments).supplies():
        raise BadInput(
            f"procedure {procedure.name} switches the units off and on, and station {station.table.name} "
            f"({station.path}) has no instrument that does: add its supply"
        )
