"""A time stamp authority (RFC 3161) at a local port, with a root and a signing certificate of its own."""

import datetime as dt
import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from asn1crypto import keys, tsp
from asn1crypto import x509 as asn1_x509
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from pyhanko.sign.timestamps import DummyTimeStamper

MOMENT = dt.datetime(2027, 1, 2, 3, 4, 5, tzinfo=dt.UTC)


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _certificate(
    subject: str, key: rsa.RSAPrivateKey, issuer: str, signer: rsa.RSAPrivateKey, *, usage: x509.ObjectIdentifier | None
) -> x509.Certificate:
    builder = (
        x509.CertificateBuilder().subject_name(_name(subject)).issuer_name(_name(issuer)).public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(MOMENT - dt.timedelta(days=1000)).not_valid_after(MOMENT + dt.timedelta(days=1000))
        .add_extension(x509.BasicConstraints(ca=usage is None, path_length=None), critical=True)
    )  # fmt: skip
    if usage is not None:
        builder = builder.add_extension(x509.ExtendedKeyUsage([usage]), critical=True)
    return builder.sign(signer, hashes.SHA256())


class Authority:
    """Stamps what is asked for; `fault` says what it does wrong instead."""

    def __init__(self, folder: Path, *, usage: x509.ObjectIdentifier = ExtendedKeyUsageOID.TIME_STAMPING) -> None:
        root_key, key = (rsa.generate_private_key(65537, 2048) for _ in range(2))
        root = _certificate("Test root", root_key, "Test root", root_key, usage=None)
        certificate = _certificate("Test TSA", key, "Test root", root_key, usage=usage)
        der = serialization.Encoding.DER
        self._stamper = DummyTimeStamper(
            asn1_x509.Certificate.load(certificate.public_bytes(der)),
            keys.PrivateKeyInfo.load(
                key.private_bytes(der, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
            ),
            fixed_dt=MOMENT,
        )
        self.root = folder / f"root-{root.serial_number}.pem"
        self.root.write_bytes(root.public_bytes(serialization.Encoding.PEM))
        self.fault = ""
        self.url = ""

    def answer(self, query: bytes) -> bytes:
        request = tsp.TimeStampReq.load(query)
        if self.fault == "refuses":
            status = tsp.PKIStatusInfo({"status": "rejection", "status_string": ["not today"]})
            content: bytes = status.dump()  # without a token, which the library demands
            return bytes((0x30, len(content))) + content
        if self.fault == "garbage":
            return b"<html>"
        if self.fault == "another":
            request["message_imprint"]["hashed_message"] = bytes(32)
        if self.fault == "replayed":
            request["nonce"] = 7
        return bytes(self._stamper.request_tsa_response(request).dump())


@contextmanager
def serving(authority: Authority) -> Iterator[Authority]:
    """Let an authority answer over HTTP."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            query = self.rfile.read(int(self.headers["Content-Length"]))
            assert self.headers["Content-Type"] == "application/timestamp-query"
            content = authority.answer(query)
            self.send_response(200)
            self.send_header("Content-Type", "application/timestamp-reply")
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: Any) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        authority.url = f"http://127.0.0.1:{server.server_port}/"
        yield authority
        server.shutdown()
        thread.join()
