"""The access list of a site: who is admitted with which key, and who is revoked; signed by the site."""

from base64 import b64decode, b64encode
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from stream.decoding import decode_json
from stream.errors import BusError, GyrofleetError
from stream.security.rights import Principal, principal_of
from stream.security.site_rules import SiteRules, Subject

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePrivateKey, EllipticCurvePublicKey

ACCESS_FILE = "access.json"


class _Entry(msgspec.Struct, frozen=True):
    common_name: str
    public_key: str  # DER, base64


class _Content(msgspec.Struct, frozen=True):
    at_ns: int
    admitted: list[_Entry]
    revoked: list[str]
    two_persons: list[str] = []  # subjects


class _File(msgspec.Struct, frozen=True):
    content: msgspec.Raw
    signature: str


class AccessList:
    """The public key of everybody who is admitted; `revoked` are those who are not any more.

    `rules` are those of the site, signed by it like the list.
    """

    def __init__(
        self, admitted: dict[Principal, bytes], revoked: frozenset[Principal], at_ns: int, rules: SiteRules
    ) -> None:
        self.admitted, self.revoked, self.at_ns, self.rules = admitted, revoked, at_ns, rules
        self._loaded: dict[Principal, EllipticCurvePublicKey] = {}

    def key_of(self, principal: Principal) -> "EllipticCurvePublicKey | None":
        """The public key of a principal; None if it is not admitted."""
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives.asymmetric.ec import EllipticCurvePublicKey
        from cryptography.hazmat.primitives.serialization import load_der_public_key

        found = self._loaded.get(principal)
        if found is None and principal in self.admitted:
            try:
                loaded = load_der_public_key(self.admitted[principal])
            except (ValueError, UnsupportedAlgorithm) as error:
                raise BusError(
                    f"the key of {principal} in the {ACCESS_FILE} of the site cannot be read: {error}"
                ) from error
            if not isinstance(loaded, EllipticCurvePublicKey):
                raise BusError(f"the key of {principal} in the {ACCESS_FILE} of the site is not of the curve P-256")
            found = self._loaded[principal] = loaded
        return found

    def reason_against(self, principal: Principal) -> str | None:
        """Why a principal is not admitted; None if it is."""
        if principal in self.revoked:
            return f"{principal} is revoked"
        if principal not in self.admitted:
            return f"{principal} is not on the access list; copy the site's newest {ACCESS_FILE} there, and restart"
        return None

    def encode(self, site_key: "EllipticCurvePrivateKey") -> bytes:
        """The list as a file, signed by the site."""
        from cryptography.hazmat.primitives.asymmetric.ec import ECDSA
        from cryptography.hazmat.primitives.hashes import SHA256

        entries = [_Entry(each.common_name, b64encode(key).decode()) for each, key in sorted(self.admitted.items())]
        revoked = sorted(each.common_name for each in self.revoked)
        content = msgspec.json.encode(_Content(self.at_ns, entries, revoked, list(self.rules.two_persons)))
        signature = b64encode(site_key.sign(content, ECDSA(SHA256()))).decode()
        return msgspec.json.encode(_File(msgspec.Raw(content), signature))


def read_access_list(path: Path, site_key: "EllipticCurvePublicKey") -> AccessList:
    """Read an access list; raises BusError if it cannot be read or is not signed by the site."""
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ec import ECDSA
    from cryptography.hazmat.primitives.hashes import SHA256

    again = "copy it from the site's folder again"
    try:
        file = decode_json(path.read_bytes(), _File)
        site_key.verify(b64decode(file.signature), bytes(file.content), ECDSA(SHA256()))
        content = decode_json(file.content, _Content)
        admitted = {principal_of(each.common_name): b64decode(each.public_key) for each in content.admitted}
        rules = SiteRules(tuple(map(Subject, content.two_persons)))
        return AccessList(admitted, frozenset(map(principal_of, content.revoked)), content.at_ns, rules)
    except InvalidSignature:
        raise BusError(f"{path} is not signed by the site; {again}") from None
    except OSError as error:
        raise BusError(f"{path} cannot be read: {error.strerror}; {again}") from error
    except (msgspec.MsgspecError, ValueError, GyrofleetError) as error:
        raise BusError(f"{path}: {error}; {again}") from error
