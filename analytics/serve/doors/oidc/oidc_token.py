"""ID tokens: signed by the provider, for this server, for this login, valid now."""

import time
from typing import Any

from authlib.oidc.core import CodeIDToken
from joserfc import jwt
from joserfc.errors import ExpiredTokenError, InvalidClaimError, InvalidKeyIdError, JoseError

from analytics.serve.doors.login_file import OidcSettings
from analytics.serve.doors.oidc.oidc_problem import OidcProblem
from analytics.serve.doors.oidc.oidc_provider import OidcProvider, Tokens

# signatures by a private key alone: none and HMAC with the client's secret are not among them
_ALGORITHMS = ["RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "Ed25519", "EdDSA"]
_MOST_CHARACTERS = 1 << 16


def verified_claims(provider: OidcProvider, oidc: OidcSettings, tokens: Tokens, nonce: str) -> dict[str, Any]:
    """The claims of an ID token; OidcProblem if it is forged, not for this login, or not valid now."""
    found = _signed(provider, tokens.id_token)
    options = {"iss": {"essential": True, "value": oidc.issuer}, "aud": {"essential": True, "value": oidc.client_id}}
    asked = {"nonce": nonce, "client_id": oidc.client_id, "access_token": tokens.access_token}
    claims = CodeIDToken(found.claims, found.header, options, asked)
    try:
        claims.validate(leeway=oidc.leeway_s)
    except JoseError as error:
        raise _refused(error, tokens.clock_s, oidc) from error
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:  # claims of odd types
        raise OidcProblem("token", f"the ID token has a claim that cannot be read: {error}") from error
    return dict(claims)


def _signed(provider: OidcProvider, text: str) -> jwt.Token:
    if len(text) > _MOST_CHARACTERS:
        raise OidcProblem("token", f"the ID token has {len(text):,} characters")
    try:
        try:
            return jwt.decode(text, provider.keys(is_newer=False), _ALGORITHMS)
        except InvalidKeyIdError:  # the provider has changed its keys
            return jwt.decode(text, provider.keys(is_newer=True), _ALGORITHMS)
    except (JoseError, ValueError, TypeError) as error:
        raise OidcProblem("token", f"the ID token is not signed by the provider: {error}") from error


def _refused(error: JoseError, clock_s: float | None, oidc: OidcSettings) -> OidcProblem:
    """Why a token does not hold; a clock that is off is the likeliest where its times are the fault."""
    is_of_time = isinstance(error, ExpiredTokenError) or (
        isinstance(error, InvalidClaimError) and error.claim in {"iat", "nbf"}
    )
    if is_of_time and clock_s is not None and abs(ahead_s := time.time() - clock_s) > max(oidc.leeway_s, 2):
        by = f"{abs(ahead_s):.0f}"
        way = "ahead of" if ahead_s > 0 else "behind"
        return OidcProblem(
            "clock", f"the clock of this server is {by} s {way} that of the provider ({error})", seconds=by
        )
    return OidcProblem("token", f"the ID token does not hold: {error}")
