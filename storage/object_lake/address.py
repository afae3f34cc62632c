"""Addresses on an object store."""

import os
import re
from typing import NamedTuple

from stream.errors import BadInput

SCHEME = "s3://"
_URL = re.compile(r"s3://([a-z0-9][a-z0-9.-]{1,61}[a-z0-9])(/[^?#\\]*)?")
_ENDPOINT = re.compile(r"https?://[^/\s]")


class BucketAddress(NamedTuple):
    """A bucket and the parts of a prefix in it."""

    bucket: str
    parts: tuple[str, ...]

    def __str__(self) -> str:
        return f"{SCHEME}{self.bucket}" + "".join(f"/{part}" for part in self.parts)


def parse_bucket(url: str) -> BucketAddress:
    """The parts of an address; BadInput if it is none.

    >>> str(parse_bucket("s3://gyros/plants/hangzhou/"))
    's3://gyros/plants/hangzhou'
    """
    match = _URL.fullmatch(url.rstrip("/"))
    parts = [] if match is None else (match[2] or "").split("/")[1:]
    if match is None or any(part in {"", ".", ".."} for part in parts):
        raise BadInput(f"{url!r} is no address on an object store; give s3://BUCKET/PREFIX")
    return BucketAddress(match[1], tuple(parts))


def check_service(endpoint_url: str | None) -> None:
    """BadInput if the address of the service, given or in the environment, is none."""
    for each in (endpoint_url, os.environ.get("AWS_ENDPOINT_URL"), os.environ.get("AWS_ENDPOINT")):
        if each and _ENDPOINT.match(each) is None:
            raise BadInput(f"the endpoint {each!r} is no address; give one that begins with http:// or https://")
