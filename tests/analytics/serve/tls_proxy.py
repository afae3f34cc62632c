"""A proxy that ends TLS, requires client certificates, and names their subjects to the server behind it."""

import http.client
import http.server
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

_SENT_ON = ("accept", "content-type", "cookie", "host", "origin", "x-csrf-token", "authorization")


class Authority:
    """A certificate authority and what it signs, as PEM files in a folder."""

    def __init__(self, folder: Path, name: str) -> None:
        self._folder, self._key = folder, ec.generate_private_key(ec.SECP256R1())
        self._name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        self.path = folder / f"{name}.pem"
        self.path.write_bytes(self._signed(self._name, self._key, is_authority=True))

    def issue(self, common_name: str, organization: str = "Plant") -> Path:
        """A file with certificate and key of a name."""
        key = ec.generate_private_key(ec.SECP256R1())
        parts = [(NameOID.ORGANIZATION_NAME, organization), (NameOID.COMMON_NAME, common_name)]
        name = x509.Name([x509.NameAttribute(kind, value) for kind, value in parts])
        path = self._folder / f"{common_name}-{id(key)}.pem"
        pem = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        path.write_bytes(pem + self._signed(name, key, is_authority=False))
        return path

    def _signed(self, subject: x509.Name, key: ec.EllipticCurvePrivateKey, *, is_authority: bool) -> bytes:
        now = datetime.now(UTC)
        builder = (
            x509.CertificateBuilder().subject_name(subject).issuer_name(self._name).public_key(key.public_key())
            .serial_number(x509.random_serial_number()).not_valid_before(now - timedelta(hours=1))
            .not_valid_after(now + timedelta(hours=1))
            .add_extension(x509.BasicConstraints(ca=is_authority, path_length=None), critical=True)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        )  # fmt: skip
        return builder.sign(self._key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


@contextmanager
def tls_proxy(target: str, server: Path, clients: Path, secret: str) -> Iterator[str]:
    """Run a proxy to `target`; its address. `server` is its certificate, `clients` the authority of clients."""

    class Forwarder(http.server.BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            sent = {name: value for name, value in self.headers.items() if name.lower() in _SENT_ON}
            assert isinstance(self.connection, ssl.SSLSocket)
            text = x509.load_der_x509_certificate(self.connection.getpeercert(binary_form=True) or b"")
            sent["X-Client-Subject"] = text.subject.rfc4514_string().encode().decode("latin-1")
            sent["X-Proxy-Secret"] = secret
            sent["X-Forwarded-For"] = f"{self.headers.get('X-Forwarded-For', '10.9.9.9')}, 10.1.2.3"
            host, _, port = target.removeprefix("http://").partition(":")
            behind = http.client.HTTPConnection(host, int(port), timeout=30)
            behind.request(self.command, self.path, self.rfile.read(length), sent)
            answer = behind.getresponse()
            body = answer.read()
            self.send_response(answer.status)
            for name, value in answer.getheaders():
                if name.lower() not in {"transfer-encoding", "content-length", "connection", "date", "server"}:
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)
            behind.close()

        do_POST = do_GET

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    class Quiet(http.server.ThreadingHTTPServer):
        def handle_error(self, *_: object) -> None:
            """A client without a certificate is no news."""

    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(server)
    context.load_verify_locations(clients)
    context.verify_mode = ssl.CERT_REQUIRED
    # TLS 1.2: there a client without a certificate is refused in the handshake, not at its first read
    context.maximum_version = ssl.TLSVersion.TLSv1_2
    with Quiet(("127.0.0.1", 0), Forwarder) as listening:
        listening.socket = context.wrap_socket(listening.socket, server_side=True, do_handshake_on_connect=False)
        thread = threading.Thread(target=listening.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield f"https://localhost:{listening.server_address[1]}"
        finally:
            listening.shutdown()
            thread.join()
