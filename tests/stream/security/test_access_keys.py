"""Keys of the access list that cannot be read are named."""

from collections.abc import Callable

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from stream.errors import BusError
from stream.security.access import AccessList
from stream.security.rights import Principal, Role
from stream.security.site_rules import SiteRules

P_256, NO_CURVE = bytes.fromhex("2a8648ce3d030107"), bytes.fromhex("2a8648ce3d340107")


@pytest.mark.parametrize("change", [lambda key: key.replace(P_256, NO_CURVE), lambda key: key[:-3]])
def test_a_key_that_cannot_be_read_is_named(change: Callable[[bytes], bytes]) -> None:
    public = ec.generate_private_key(ec.SECP256R1()).public_key()
    key = public.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    assert change(key) != key
    principal = Principal(Role.STATION, "chamber-2")
    access = AccessList({principal: change(key)}, frozenset(), 0, SiteRules())
    with pytest.raises(BusError, match=r"the key of .*chamber-2 in the .* cannot be read"):
        access.key_of(principal)
