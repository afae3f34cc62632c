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


_COMMANDS = {
    "Bring data in": {
        "demo": "analytics.commands.services.demo:demo",
        "import": "ingest.commands.import_files:import_files",
        "can": "ingest.commands.can:can",
        "procedure": "ingest.commands.procedure:procedure",
        "run": "ingest.commands.run:run",
        "control": "ingest.commands.control:control",
        "simulate": "ingest.commands.simulate:simulate",
        "run-simulated": "ingest.commands.run:run_simulated",
        "check": "ingest.commands.check:check",
        "runs": "storage.commands.runs:runs",
    },
    "Record and estimate": {
        "record": "storage.commands.record:record",
        "router": "storage.commands.record:router",
        "estimate": "storage.commands.estimate:estimate",
        "replay": "ingest.commands.replay:replay",
        "status": "storage.commands.status:status",
        "alert": "analytics.commands.services.alert:alert",
    },
    "Ask": {
        "sql": "storage.commands.sql:sql",
        "allan": "analytics.commands.allan:allan",
        "spectrum": "analytics.commands.spectrum:spectrum",
        "metrics": "analytics.commands.evaluation.metrics:metrics",
        "trend": "analytics.commands.evaluation.trend:trend",
        "limits": "analytics.commands.evaluation.limits:limits",
        "verdicts": "analytics.commands.evaluation.verdicts:verdicts",
    },
    "Certify": {
        "budget": "analytics.commands.evaluation.budget:budget",
        "attitude": "analytics.commands.evaluation.attitude:attitude",
        "certificate": "analytics.commands.records.certificate:certificate",
        "audit": "analytics.commands.records.audit:audit",
    },
    "Close the loop": {
        "diagnose": "analytics.commands.closed_loop.diagnose:diagnose",
        "model": "analytics.commands.closed_loop.model:model",
        "compensate": "analytics.commands.closed_loop.compensate:compensate",
    },
    "Show": {"serve": "analytics.commands.services.serve:serve", "users": "analytics.commands.services.users:users"},
    "Secure the bus, and who decides": {
        "site": "storage.commands.site:site",
        "proposal": "analytics.commands.records.proposal:proposal",
    },
    "Keep roles at work": {
        "config": "analytics.commands.services.config:config",
        "supervise": "analytics.commands.services.config:supervise",
    },
    "Look after the store": {
        "lake": "storage.commands.lake:lake",
        "rebuild": "storage.commands.lake:rebuild",
        "retain": "storage.commands.lake:retain",
        "verify": "storage.commands.verify:verify",
        "recover": "storage.commands.verify:recover",
        "attest": "storage.commands.attest:attest",
        "backup": "storage.commands.backup:backup",
        "restore": "storage.commands.backup:restore",
        "replicate": "storage.commands.replicate:replicate",
    },
    "Give to other programs": {"export-iceberg": "storage.commands.export_iceberg:export_iceberg"},
    "Shell": {"completion": "stream.terminal.completion:completion"},
}
"""Sections of the help, with each command and where it is; a command that is not asked for is not loaded."""

for _title, _places in _COMMANDS.items():
    main.add_section(_title, _places)


def front_door() -> NoReturn:
    """Run the command line, and end the process with its exit code; with that of SIGPIPE if the output pipe closes.

    Libraries are not unloaded: a library's thread that still runs then aborts the process (exit code -6).
    """
    from stream.no_pandas import hide_pandas
    from stream.terminal.console import output_is_closed

    hide_pandas()
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
