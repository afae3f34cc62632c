"""An object store (moto's server), a faulty line to it, and a store whose lake is published."""

import logging
from collections.abc import Iterator
from itertools import count

import pytest

from storage.object_lake.bucket import Bucket
from tests.storage.conftest import Filler, fill_days
from tests.storage.object_lake.faulty_proxy import FaultyProxy

_PREFIXES = count()


@pytest.fixture(scope="session")
def object_store_port() -> Iterator[int]:
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    yield server.get_host_and_port()[1]
    server.stop()


@pytest.fixture
def aws(monkeypatch: pytest.MonkeyPatch, object_store_port: int) -> str:
    """Endpoint, with credentials in the environment; the bucket `fleet` exists."""
    import boto3

    endpoint = f"http://127.0.0.1:{object_store_port}"
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "AKIATESTKEY")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "a-secret-that-nobody-may-see")
    monkeypatch.setenv("AWS_REGION", "us-east-1")
    boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1").create_bucket(Bucket="fleet")
    return endpoint


@pytest.fixture
def days(filler: Filler) -> Filler:
    """Three days of two segments: each costs eight requests."""
    return fill_days(filler, 2)


@pytest.fixture
def url() -> str:
    """An address that no other test has."""
    return f"s3://fleet/plants/{next(_PREFIXES)}"


@pytest.fixture
def proxy(aws: str, object_store_port: int) -> Iterator[FaultyProxy]:
    proxy = FaultyProxy(object_store_port)
    yield proxy
    proxy.close()


@pytest.fixture
def bucket(aws: str, url: str) -> Bucket:
    return Bucket(url, aws)


@pytest.fixture
def faulty(proxy: FaultyProxy, url: str) -> Bucket:
    return Bucket(url, proxy.url, timeout_s=1.0, retries=3)
