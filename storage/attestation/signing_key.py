"""The Ed25519 key (RFC 8032) that signs attestations: a PEM file that only its owner can read, outside any store."""

import hashlib
import os
from pathlib import Path

from stream.errors import BadInput, StoreError
from stream.security.file_modes import fault_of_secret

_HEX_DIGITS = 16


def default_key() -> Path:
    """Where a user's key is by default."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "gyrofleet" / "attest.pem"


def fingerprint(public: bytes) -> str:
    """Name of a public key for people: the first 16 hexadecimal digits of its SHA-256.

    >>> fingerprint(bytes(32))
    '66687aadf862bd77'
    """
    return hashlib.sha256(public).hexdigest()[:_HEX_DIGITS]


class SigningKey:
    """A key that signs; `public` are the 32 bytes of its public half."""

    def __init__(self, path: Path) -> None:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key

        if path.exists() and not path.is_file():
            raise BadInput(f"--key {path}: it is no file; give another path, where a key is made if there is none")
        try:
            fault, content = fault_of_secret(path), path.read_bytes()
        except OSError as error:
            raise BadInput(f"--key {path}: cannot be read: {error.strerror}") from error
        if fault:
            raise BadInput(f"--key {path}: {fault}, or make a new key")
        try:
            key = load_pem_private_key(content, password=None)
        except (ValueError, TypeError) as error:
            raise BadInput(f"--key {path}: it holds no private key in PEM without a passphrase") from error
        if not isinstance(key, Ed25519PrivateKey):
            raise BadInput(f"--key {path}: it is no Ed25519 key; `gyrofleet attest` makes one where there is no file")
        self._key = key
        self.public = key.public_key().public_bytes_raw()

    def sign(self, content: bytes) -> bytes:
        """Signature of 64 bytes."""
        return self._key.sign(content)


def create_key(path: Path) -> None:
    """Write a new key, with its public half beside it as ``.pub``; FileExistsError if there is one."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    key = Ed25519PrivateKey.generate()
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    public = key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(private)
            file.flush()
            os.fsync(file.fileno())
        path.with_suffix(".pub").write_bytes(public)
    except FileExistsError:
        raise
    except OSError as error:
        raise StoreError(f"the key {path} cannot be written: {error}; give --key FILE elsewhere") from error


def is_signed(public: bytes, signature: bytes, content: bytes) -> bool:
    """Whether a signature is of that key and content."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        Ed25519PublicKey.from_public_bytes(public).verify(signature, content)
    except (InvalidSignature, ValueError):
        return False
    return True
