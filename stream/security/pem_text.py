"""Keys and certificates in PEM where another file is expected: what is wrong with it is named without its content."""

import re

_PEM = re.compile(rb"^-----BEGIN ", re.MULTILINE)


def fault_of_pem(content: bytes) -> str:
    r"""Why a content is no file of another kind; empty if it has no key or certificate in PEM.

    >>> fault_of_pem(b"serial\nFOG-1\n"), fault_of_pem(b"-----BEGIN PRIVATE KEY-----\nMC4C\n")
    ('', 'it is a key or a certificate (PEM), of which nothing is shown; give another file')
    """
    is_pem = _PEM.search(content) is not None
    return "it is a key or a certificate (PEM), of which nothing is shown; give another file" if is_pem else ""
