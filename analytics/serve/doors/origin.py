"""Where a request comes from: the name of this server, and the site of the page that sent it."""

import ipaddress
from collections.abc import Collection
from urllib.parse import urlsplit

from starlette.datastructures import Headers


def is_loopback(host: str) -> bool:
    """Whether an address to listen on is reached from this machine only.

    >>> is_loopback("127.0.0.1"), is_loopback("localhost"), is_loopback("0.0.0.0")
    (True, True, False)
    """
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_named(host: str, names: Collection[str]) -> bool:
    """Whether a Host header names this server: by an address, localhost, or one of `names`.

    Another name would be one that a foreign site has made to point here (DNS rebinding); an address cannot be.

    >>> is_named("127.0.0.1:8000", ()), is_named("[::1]:80", ()), is_named("evil.example", ()), is_named("a:b:c", ())
    (True, True, False, False)
    """
    try:
        name = urlsplit(f"//{host}").hostname
        urlsplit(f"//{host}").port  # noqa: B018  raises if it is no number
    except ValueError:
        return False
    if not name or any(each in host for each in "/@?#"):
        return False
    if name == "localhost" or name in {each.lower() for each in names}:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def local_path(text: str) -> str:
    r"""A path of this server to go to; the first page for anything else.

    >>> [local_path(each) for each in ("/units?lot=7", "//evil.example", "https://e.example", "/\\e.example", "//[")]
    ['/units?lot=7', '/', '/', '/', '/']
    """
    try:
        parts = urlsplit(text)
    except ValueError:
        return "/"
    is_local = text.startswith("/") and not (parts.netloc or parts.scheme or text.startswith("//") or "\\" in text)
    return text if is_local and text.isprintable() else "/"


def is_of_this_site(headers: Headers, *, is_secure: bool) -> bool:
    """Whether a browser says that a page of this server sent the request; programs say nothing, and are believed.

    Where browsers come by TLS, a page without it is another site: anybody on the way could have written it.
    """
    site = headers.get("sec-fetch-site")
    if site is not None and site not in {"same-origin", "none"}:
        return False
    origins = headers.getlist("origin")
    if not origins:
        return True
    try:
        origin = urlsplit(origins[0])
    except ValueError:
        return False
    schemes = {"https"} if is_secure else {"http", "https"}
    return len(origins) == 1 and origin.scheme in schemes and origin.netloc.lower() == headers.get("host", "").lower()
