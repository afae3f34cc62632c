"""Options that name a lake on an object store, and the store that a command reads by them."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from storage.store import Store

endpoint_option = click.option(
    "--endpoint-url", metavar="URL", help="Of the object store.  [default: AWS_ENDPOINT_URL, else Amazon's]"
)


def lake_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of a command that reads a store, or the published lake of one."""
    for option in (
        click.option("--cache-size", metavar="SIZE", help="Of the local cache of published lakes.  [default: 10GB]"),
        endpoint_option,
        click.option(
            "--lake", "url", metavar="s3://BUCKET/PREFIX", help="Read the lake published there instead of --store."
        ),
    ):
        command = option(command)
    return command


def asked_at(folder: Path, url: str | None, endpoint_url: str | None, cache_size: str | None) -> "Path | Store":
    """The folder of a store, or the store of the lake at an address; StoreError if there is none."""
    from stream.errors import BadInput

    if url is None:
        if endpoint_url is not None or cache_size is not None:
            raise BadInput("--endpoint-url and --cache-size are of a published lake: give --lake s3://BUCKET/PREFIX")
        return folder
    from storage.object_lake.published_store import PublishedStore
    from storage.upkeep.retention import parse_size

    return PublishedStore.open_url(
        url, endpoint_url, cache_bytes=None if cache_size is None else parse_size(cache_size)
    )
