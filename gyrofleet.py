"""The front door: the commands of all packages, assembled."""

import atexit
import os
import sys
from contextlib import suppress
from typing import NoReturn

import click

from analytics.commands.allan import allan
from analytics.commands.compensate import compensate
from analytics.commands.demo import demo
from analytics.commands.diagnose import diagnose
from analytics.commands.limits import limits
from analytics.commands.metrics import metrics
from analytics.commands.model import model
from analytics.commands.spectrum import spectrum
from analytics.commands.trend import trend
from analytics.commands.verdicts import verdicts
from ingest.commands.can import can
from ingest.commands.check import check
from ingest.commands.import_files import import_files
from ingest.commands.procedure import procedure
from ingest.commands.replay import replay
from ingest.commands.run import run
from ingest.commands.simulate import simulate
from storage.commands.estimate import estimate
from storage.commands.lake import lake, rebuild, retain
from storage.commands.record import record, router
from storage.commands.sql import sql
from storage.commands.verify import recover, verify


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="gyrofleet")
def main() -> None:
    """Screen many gyroscopes for hours or weeks: record, estimate while it flows, ask in SQL."""


for command in (
    demo,
    import_files,
    can,
    procedure,
    run,
    simulate,
    record,
    router,
    estimate,
    replay,
    lake,
    rebuild,
    retain,
    verify,
    recover,
    sql,
    allan,
    spectrum,
    trend,
    metrics,
    check,
    limits,
    verdicts,
    diagnose,
    model,
    compensate,
):
    main.add_command(command)


def front_door() -> NoReturn:
    """Run the command line, and end the process with its exit code.

    The code is the command's own: a library's thread that is still at work while its library is taken down aborts the
    process (seen as -6 behind a message that had been told in order), so that is not waited for.
    """
    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    with suppress(OSError):  # whoever read the output has gone
        atexit._run_exitfuncs()  # noqa: SLF001  what Python does before it takes the libraries down
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(code)


if __name__ == "__main__":
    front_door()
