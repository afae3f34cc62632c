"""Options that name a lake on an object store."""

import click

endpoint_option = click.option(
    "--endpoint-url", metavar="URL", help="Of the object store.  [default: AWS_ENDPOINT_URL, else Amazon's]"
)
lake_option = click.option(
    "--lake", "url", metavar="s3://BUCKET/PREFIX", help="Read the lake published there instead of a store."
)
