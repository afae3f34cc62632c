"""The front door: what `import gyrofleet` offers in Python, and the commands of all packages, assembled.

>>> import gyrofleet as gf
>>> curve = gf.allan_deviation([1.0, 3.0, 2.0, 6.0, 4.0], rate_hz=1.0)
>>> curve.tau_s.tolist()
[1.0, 2.0]
"""

import atexit
import importlib
import importlib.util
import io
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

_IS_COMMAND = Path(sys.argv[0]).name == "gyrofleet" and signal.getsignal(signal.SIGINT) is signal.default_int_handler
if _IS_COMMAND:  # Ctrl-C while libraries load ends it without a traceback
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import click  # noqa: E402  after the handler above

for _name in ("stream", "storage", "ingest", "analytics"):
    _spec = importlib.util.find_spec(_name)
    _origin = None if _spec is None else _spec.origin
    if _origin is None or Path(_origin).resolve().parents[1] != Path(__file__).resolve().parent:
        raise ImportError(
            f"gyrofleet needs its own package {_name!r}, but Python finds {_origin or 'none'} first: rename that file "
            "or folder, or start Python in another folder"
        )

from stream.terminal.command_group import CommandGroup  # noqa: E402  after the check above

if TYPE_CHECKING:
    from analytics.api.arrays import DeviationCurve, allan_deviation, noise_fit
    from analytics.api.store import FleetStore, open_store
    from stream.errors import BadInput, GyrofleetError, NotEnoughData, NotFound, QueryError, StoreError, UnknownUnit

_OFFERED = {
    "DeviationCurve": "analytics.api.arrays",
    "FleetStore": "analytics.api.store",
    "allan_deviation": "analytics.api.arrays",
    "noise_fit": "analytics.api.arrays",
    "open_store": "analytics.api.store",
    "BadInput": "stream.errors",
    "GyrofleetError": "stream.errors",
    "NotEnoughData": "stream.errors",
    "NotFound": "stream.errors",
    "QueryError": "stream.errors",
    "StoreError": "stream.errors",
    "UnknownUnit": "stream.errors",
}
__all__ = [
    "BadInput",
    "DeviationCurve",
    "FleetStore",
    "GyrofleetError",
    "NotEnoughData",
    "NotFound",
    "QueryError",
    "StoreError",
    "UnknownUnit",
    "allan_deviation",
    "main",
    "noise_fit",
    "open_store",
]


def __getattr__(name: str) -> Any:
    if name in _OFFERED:  # commands that need none of it start faster
        return getattr(importlib.import_module(_OFFERED[name]), name)
    raise AttributeError(f"gyrofleet offers no {name!r}: it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    return __all__


@click.group(cls=CommandGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="gyrofleet")
def main() -> None:
    """Screen many gyroscopes for hours or weeks: record, estimate while it flows, ask in SQL."""


def _add_commands() -> None:
    """Add the commands of all packages, in the order of use."""
    from analytics.commands.allan import allan
    from analytics.commands.closed_loop.compensate import compensate
    from analytics.commands.closed_loop.diagnose import diagnose
    from analytics.commands.closed_loop.model import model
    from analytics.commands.evaluation.attitude import attitude
    from analytics.commands.evaluation.budget import budget
    from analytics.commands.evaluation.limits import limits
    from analytics.commands.evaluation.metrics import metrics
    from analytics.commands.evaluation.trend import trend
    from analytics.commands.evaluation.verdicts import verdicts
    from analytics.commands.records.audit import audit
    from analytics.commands.records.certificate import certificate
    from analytics.commands.records.proposal import proposal
    from analytics.commands.services.alert import alert
    from analytics.commands.services.config import config, supervise
    from analytics.commands.services.demo import demo
    from analytics.commands.services.serve import serve
    from analytics.commands.services.users import users
    from analytics.commands.spectrum import spectrum
    from ingest.commands.can import can
    from ingest.commands.check import check
    from ingest.commands.control import control
    from ingest.commands.import_files import import_files
    from ingest.commands.procedure import procedure
    from ingest.commands.replay import replay
    from ingest.commands.run import run, run_simulated
    from ingest.commands.simulate import simulate
    from storage.commands.attest import attest
    from storage.commands.backup import backup, restore
    from storage.commands.estimate import estimate
    from storage.commands.export_iceberg import export_iceberg
    from storage.commands.lake import lake, rebuild, retain
    from storage.commands.record import record, router
    from storage.commands.replicate import replicate
    from storage.commands.site import site
    from storage.commands.sql import sql
    from storage.commands.status import status
    from storage.commands.verify import recover, verify
    from stream.terminal.completion import completion

    main.add_section("Bring data in", demo, import_files, can, procedure, run, control, simulate, run_simulated, check)
    main.add_section("Record and estimate", record, router, estimate, replay, status, alert)
    main.add_section("Ask", sql, allan, spectrum, metrics, trend, limits, verdicts)
    main.add_section("Certify", budget, attitude, certificate, audit)
    main.add_section("Close the loop", diagnose, model, compensate)
    main.add_section("Show", serve, users)
    main.add_section("Secure the bus, and who decides", site, proposal)
    main.add_section("Keep roles at work", config, supervise)
    main.add_section("Look after the store", lake, rebuild, retain, verify, recover, attest, backup, restore, replicate)
    main.add_section("Give to other programs", export_iceberg)
    main.add_section("Shell", completion)


_add_commands()


def front_door() -> NoReturn:
    """Run the command line, and end the process with its exit code; with that of SIGPIPE if the output pipe closes.

    Libraries are not unloaded: a library's thread that still runs then aborts the process (exit code -6).
    """
    from stream.terminal.console import output_is_closed

    for stream in (sys.stdout, sys.stderr):  # a terminal without a degree sign shows a question mark
        if isinstance(stream, io.TextIOWrapper) and stream.encoding.lower() != "utf-8":
            stream.reconfigure(errors="replace")
    code = 0
    if _IS_COMMAND:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if code == 1 and output_is_closed():  # click's code for a broken pipe
            code = 128 + signal.SIGPIPE
    with suppress(OSError):
        atexit._run_exitfuncs()  # noqa: SLF001  what Python does before it unloads the libraries
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    front_door()
