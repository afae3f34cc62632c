"""MACs of messages under the secret of a source and a recorder.

A MAC is the tag of AES-256-GCM, which processors have instructions for: a quarter of the time of BLAKE2b. Its key must
never see a number twice. So each process of a source begins a session: 16 random bytes, which make a key of the secret,
under which the source counts its messages. The MAC holds session, number and tag. Earlier versions send 16 bytes of
keyed BLAKE2b, which have no number.
"""

from functools import lru_cache
from hashlib import blake2b

SESSION_BYTES, NUMBER_BYTES, TAG_BYTES = 16, 12, 16
MAC_BYTES = SESSION_BYTES + NUMBER_BYTES + TAG_BYTES
EARLIER_MAC_BYTES = 16


class MacSession:
    """MACs under the key of one session, which is made of the secret and the session's random name.

    The end of what `encrypt` returns is the tag: where each message counts, it is called without the call of `tag`.

    >>> session = MacSession(bytes(32), bytes(SESSION_BYTES))
    >>> session.tag(bytes(NUMBER_BYTES), "gyrofleet/plant/c1/U1/rate", b"samples").hex()
    'd1ba91bb7e80d86fdb4584a7874cedda'
    """

    def __init__(self, secret: bytes, name: bytes) -> None:
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        self.encrypt = AESGCM(blake2b(name, digest_size=32, key=secret, person=b"gyrofleet gcm").digest()).encrypt

    def tag(self, number: bytes, key: str, body: bytes) -> bytes:
        """The tag of a message and its key expression; the enciphered key expression before it is not needed."""
        return self.encrypt(number, message_context(key), body)[-TAG_BYTES:]


def earlier_mac(secret: bytes, key: str, body: bytes) -> bytes:
    """The MAC of a message as earlier versions send it."""
    state = blake2b(message_context(key), digest_size=EARLIER_MAC_BYTES, key=secret)
    state.update(body)
    return state.digest()


@lru_cache(maxsize=50_000)
def message_context(key: str) -> bytes:
    """What a proof covers besides the message: its kind and its key expression."""
    return b"gyrofleet message\0" + key.encode() + b"\0"
