"""A provider of OpenID Connect as a process: discovery, authorization code with PKCE, tokens, keys, logout.

It does what the standard asks of a provider, until POST /lie says in which point it should not. `python FILE` prints
its address.
"""

import base64
import hashlib
import hmac
import json
import secrets
import socket
import time
from email.utils import formatdate
from typing import Any
from urllib.parse import parse_qs, urlencode

import uvicorn
from joserfc import jwk, jwt
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

CLIENT, SECRET = "gyrofleet-test", "secret of the client in these tests"
KEYS = [jwk.RSAKey.generate_key(2048, {"kid": "one"}), jwk.RSAKey.generate_key(2048, {"kid": "two"})]
FORGED = jwk.RSAKey.generate_key(2048, {"kid": "one"})
codes: dict[str, dict[str, str]] = {}
lies: dict[str, Any] = {}
heard: list[dict[str, str]] = []
used: set[str] = set()
site = ""


async def lie(request: Request) -> Response:
    """What to do wrong from now on, and the claims of who logs in."""
    lies.clear()
    lies.update(await request.json())
    return PlainTextResponse("")


async def discovery(request: Request) -> Response:
    if lies.get("discovery") == "broken":
        return PlainTextResponse("no JSON")
    found = {
        "issuer": lies.get("discovery_issuer", site), "authorization_endpoint": f"{site}/authorize",
        "token_endpoint": f"{site}/token", "jwks_uri": f"{site}/keys", "end_session_endpoint": f"{site}/logout",
        "response_types_supported": ["code"], "code_challenge_methods_supported": ["S256"],
        "token_endpoint_auth_methods_supported": ["client_secret_basic"],
        "authorization_response_iss_parameter_supported": True,
    }  # fmt: skip
    return JSONResponse(found)


async def keys(request: Request) -> Response:
    published = KEYS[:1] if lies.get("keys") != "new" else KEYS
    return JSONResponse({"keys": [key.as_dict(private=False) for key in published]})


async def authorize(request: Request) -> Response:
    asked = dict(request.query_params)
    assert asked["response_type"] == "code"
    assert asked["client_id"] == CLIENT
    assert asked["code_challenge_method"] == "S256"
    assert "openid" in asked["scope"].split()
    if "error" in lies:
        answer = {"error": lies["error"], "error_description": "<script>alert(1)</script>"}
    else:
        code = secrets.token_urlsafe(16)
        codes[code] = asked
        answer = {"code": code}
    answer |= {"state": asked["state"], "iss": lies.get("answer_issuer", site)}
    return RedirectResponse(f"{asked['redirect_uri']}?{urlencode(answer)}", 302)


async def token(request: Request) -> Response:
    fields = {name: values[0] for name, values in parse_qs((await request.body()).decode()).items()}
    heard.append(fields)
    given = base64.b64decode(request.headers.get("authorization", "").removeprefix("Basic ")).decode()
    if given != f"{CLIENT}:{SECRET}":
        return JSONResponse({"error": "invalid_client"}, 401)
    code = fields.get("code", "")
    asked = codes.get(code)
    if asked is None or code in used or fields.get("redirect_uri") != asked["redirect_uri"]:
        return JSONResponse({"error": "invalid_grant"}, 400)
    digest = hashlib.sha256(fields.get("code_verifier", "").encode()).digest()
    if base64.urlsafe_b64encode(digest).decode().rstrip("=") != asked["code_challenge"]:
        return JSONResponse({"error": "invalid_grant", "error_description": "PKCE"}, 400)
    used.add(code)
    answer = {"access_token": "access", "token_type": "Bearer", "expires_in": 300, "id_token": id_token(asked)}
    now_s = time.time() + lies.get("clock_s", 0)
    return JSONResponse(answer, headers={"Date": formatdate(now_s, usegmt=True), "Cache-Control": "no-store"})


def id_token(asked: dict[str, str]) -> str:
    now_s = int(time.time() + lies.get("clock_s", 0))
    claims: dict[str, Any] = {
        "iss": site, "sub": "8f1e", "aud": CLIENT, "iat": now_s, "exp": now_s + 300, "nonce": asked["nonce"],
        "preferred_username": "wang.li", "groups": ["gyro engineers", "canteen"],
    }  # fmt: skip
    claims |= {name: value for name, value in lies.get("claims", {}).items() if value is not None}
    for name in [name for name, value in lies.get("claims", {}).items() if value is None]:
        del claims[name]
    for name in ("iat", "exp", "nbf"):  # relative to now
        if name in lies.get("moved_s", {}):
            claims[name] = now_s + lies["moved_s"][name]
    signed = lies.get("signed", "right")
    if signed == "none":
        head = _part(b'{"alg":"none"}')
        return f"{head}.{_part(json.dumps(claims).encode())}."
    if signed == "hmac of the secret":
        return jwt.encode({"alg": "HS256"}, claims, jwk.OctKey.import_key(SECRET))
    if signed == "hmac of the public key":
        text = ".".join(_part(json.dumps(each).encode()) for each in ({"alg": "HS256", "kid": "one"}, claims))
        return f"{text}.{_part(hmac.digest(KEYS[0].as_pem(private=False), text.encode(), 'sha256'))}"
    key = {"right": KEYS[0], "forged": FORGED, "new": KEYS[1]}[signed]
    text = jwt.encode({"alg": "RS256", "kid": str(key.kid)}, claims, key)
    if lies.get("changed"):
        head, _, tail = text.split(".")
        text = f"{head}.{_part(json.dumps(claims | lies['changed']).encode())}.{tail}"
    return text


async def logout(request: Request) -> Response:
    return PlainTextResponse("logged out " + request.query_params.get("post_logout_redirect_uri", ""))


def _part(content: bytes) -> str:
    return base64.urlsafe_b64encode(content).decode().rstrip("=")


def main() -> None:
    global site  # noqa: PLW0603  one provider a process
    listening = socket.socket()
    listening.bind(("127.0.0.1", 0))
    site = f"http://127.0.0.1:{listening.getsockname()[1]}"
    get = [("/.well-known/openid-configuration", discovery), ("/keys", keys), ("/authorize", authorize),
           ("/logout", logout)]  # fmt: skip
    post = [("/lie", lie), ("/token", token)]
    routes = [Route(path, each, methods=[m]) for m, these in (("GET", get), ("POST", post)) for path, each in these]
    print(site, flush=True)
    config = uvicorn.Config(Starlette(routes=routes), log_level="warning", date_header=False)
    uvicorn.Server(config).run(sockets=[listening])


if __name__ == "__main__":
    main()
