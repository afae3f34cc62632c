"""The front door: the commands of all packages, assembled."""

import click

from analytics.allan_cli import allan
from analytics.cli import demo
from analytics.spectrum_cli import spectrum
from ingest.cli import import_files
from storage.cli import record, sql
from storage.estimate_cli import estimate


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="gyrofleet")
def main() -> None:
    """Screen many gyroscopes for hours or weeks: record, estimate while it flows, ask in SQL."""


for command in (demo, import_files, record, estimate, sql, allan, spectrum):
    main.add_command(command)

if __name__ == "__main__":
    main()
