"""The front door: the commands of all packages, assembled."""

import atexit
import os
import sys
from contextlib import suppress
from typing import NoReturn

import click

from analytics.allan_cli import allan
from analytics.cli import demo
from analytics.compensate_cli import compensate
from analytics.diagnose_cli import diagnose
from analytics.limits_cli import limits
from analytics.metrics_cli import metrics
from analytics.model_cli import model
from analytics.spectrum_cli import spectrum
from analytics.trend_cli import trend
from analytics.verdicts_cli import verdicts
from ingest.can_cli import can
from ingest.cli import import_files
from ingest.enter_cli import check
from ingest.procedure_cli import procedure
from ingest.replay_cli import replay
from ingest.run_cli import run
from ingest.simulate_cli import simulate
from storage.cli import sql
from storage.estimate_cli import estimate
from storage.lake_cli import lake, rebuild, retain
from storage.record_cli import record, router
from storage.verify_cli import recover, verify


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
