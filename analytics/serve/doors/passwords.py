"""Hashed passwords: scrypt of the standard library, its cost stored beside each hash."""

import hashlib
import hmac
import re
import secrets
import threading

from stream.errors import BadInput

LEAST_CHARACTERS = 10
_MOST_CHARACTERS = 1000
# 32 MiB and a quarter of a second on a machine of today
_COST, _BLOCK, _PARALLEL = 2**15, 8, 3
_MEMORY_BYTES = 256 << 20
_HASH = re.compile(r"scrypt:(\d{1,8}):(\d{1,3}):(\d{1,3}):([0-9a-f]{32}):([0-9a-f]{64})")
_ABSENT = f"scrypt:{_COST}:{_BLOCK}:{_PARALLEL}:{'0' * 32}:{'0' * 64}"
# one at a time: a crowd of logins must not take the machine
_alone = threading.Lock()


def hashed(password: str) -> str:
    """A password as it is stored.

    >>> matches("correct horse battery", hashed("correct horse battery")), matches("wrong", None)
    (True, False)
    """
    if not LEAST_CHARACTERS <= len(password) <= _MOST_CHARACTERS:
        raise BadInput(
            f"the password has {len(password)} characters; {LEAST_CHARACTERS} to {_MOST_CHARACTERS} are needed"
        )
    salt = secrets.token_bytes(16)
    return f"scrypt:{_COST}:{_BLOCK}:{_PARALLEL}:{salt.hex()}:{_digest(password, salt, _COST, _BLOCK, _PARALLEL)}"


def matches(password: str, stored: str | None) -> bool:
    """Whether a password is the stored one; without a stored one it takes as long, and is not."""
    found = _HASH.fullmatch(stored or _ABSENT)
    if found is None or len(password) > _MOST_CHARACTERS:
        return False
    cost, block, parallel = (int(found[at]) for at in (1, 2, 3))
    digest = _digest(password, bytes.fromhex(found[4]), cost, block, parallel)
    return hmac.compare_digest(digest, found[5]) and stored is not None


def is_hash(text: str) -> bool:
    """Whether a text is a hash that this module has made."""
    return _HASH.fullmatch(text) is not None


def _digest(password: str, salt: bytes, cost: int, block: int, parallel: int) -> str:
    secret = password.encode(errors="surrogatepass")
    with _alone:
        try:
            digest = hashlib.scrypt(secret, salt=salt, n=cost, r=block, p=parallel, maxmem=_MEMORY_BYTES, dklen=32)
        except ValueError as error:
            raise BadInput(f"a stored password has a cost that cannot be computed ({error}); set it again") from error
    return digest.hex()
