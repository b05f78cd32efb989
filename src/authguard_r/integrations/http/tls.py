# SPDX-License-Identifier: Apache-2.0
"""TLS 1.3 between a port and a server's protocol, with the client's certificates handed on.

The standard library's TLS refuses a certificate whose purpose it does not know, and ours say a role
and nothing else. So OpenSSL takes every certificate: it still checks that its holder has the key;
`keys.trust` checks the chain for each request anew. Spec page: docs/spec/http.md#tls
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.serialization import Encoding
from OpenSSL import SSL

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.http_listener.connection import CHAIN, HttpConnection
from authguard_r.keys.files import read_private
from authguard_r.keys.trust import read_file

#: Most bytes that are given to OpenSSL, or taken from it, at once.
_CHUNK = 1 << 16


def read_context(cert: Path, key: Path, *, client_certificates: bool) -> SSL.Context:
    """Return what a server needs to speak TLS 1.3.

    Args:
        cert: the server's certificate, with what stands above it, in PEM.
        key: its private key, which its owner alone can read.
        client_certificates: a client has to show one.

    Raises:
        EnvironmentFault: a file cannot be read, or others can read the key.
        MalformedError: they are no certificate and its key.
    """
    read_file(cert)
    read_private(key, where="--tls-key")
    context = SSL.Context(SSL.TLS_SERVER_METHOD)
    context.set_min_proto_version(SSL.TLS1_3_VERSION)
    # a session that is taken up again would bring no chain with it
    context.set_session_cache_mode(SSL.SESS_CACHE_OFF)
    context.set_options(SSL.OP_NO_TICKET)
    try:
        context.use_certificate_chain_file(str(cert))
        context.use_privatekey_file(str(key))
        context.check_privatekey()
    except SSL.Error as error:
        raise MalformedError(
            "expected a certificate in PEM and its private key, unsealed", where="--tls-cert"
        ) from error
    if client_certificates:
        demand = SSL.VERIFY_PEER | SSL.VERIFY_FAIL_IF_NO_PEER_CERT
        context.set_verify(demand, lambda *_: True)  # `clients.Certificates` judges it
    return context


class Secured(asyncio.Protocol):
    """One connection: TLS outside, a protocol that knows nothing of it inside.

    Args:
        context: the server's certificate, and whether a client's is asked for.
        guest: whose connection it is.
        make: makes the protocol inside.
    """

    _outer: asyncio.Transport
    _late: asyncio.TimerHandle

    def __init__(
        self, context: SSL.Context, guest: HttpConnection, make: Callable[[], asyncio.Protocol]
    ) -> None:
        self._tls = SSL.Connection(context, None)
        self._tls.set_accept_state()
        self._guest = guest
        self._inner = make()
        self._is_open = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wait for the handshake."""
        if not isinstance(transport, asyncio.Transport):  # pragma: no cover - it is a stream
            raise TypeError("expected a stream")
        self._outer = transport
        self._guest.arrive(transport)
        loop = asyncio.get_running_loop()
        self._late = loop.call_at(self._guest.until_s, transport.abort)

    def data_received(self, data: bytes) -> None:
        """Take what came; what is no TLS ends the connection."""
        self._tls.bio_write(data)
        try:
            if not self._is_open:
                self._shake()
            self._read()
        except SSL.WantReadError:
            self.flush()
        except SSL.Error:
            self.flush()  # the alert that says so
            self._outer.close()

    def connection_lost(self, exc: Exception | None) -> None:
        """Tell the protocol inside, if it knew of the connection."""
        self._late.cancel()
        self._guest.leave()
        if self._is_open:
            self._is_open = False
            self._inner.connection_lost(exc)

    def pause_writing(self) -> None:
        """Tell the protocol inside that the client does not read; no handshake is that long."""
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        """Tell the protocol inside that the client reads again."""
        self._inner.resume_writing()

    def write(self, data: bytes) -> None:
        """Send plain bytes, a part at a time: what lies in OpenSSL is moved with every read."""
        for at in range(0, len(data), _CHUNK):
            self._tls.sendall(data[at : at + _CHUNK])
            self.flush()

    def flush(self) -> None:
        """Send what OpenSSL has to say."""
        while True:
            try:
                self._outer.write(self._tls.bio_read(_CHUNK))
            except SSL.WantReadError:
                return

    def say_goodbye(self) -> None:
        """Say that nothing more comes."""
        self._tls.shutdown()
        self.flush()

    def _shake(self) -> None:
        """Go on with the handshake, and open the protocol inside once it is over."""
        self._tls.do_handshake()
        self.flush()
        self._late.cancel()
        self._is_open = True
        self._inner.connection_made(_Plain(self._outer, self, _chain_of(self._tls)))

    def _read(self) -> None:
        while not self._outer.is_closing():
            try:
                data = self._tls.recv(_CHUNK)
            except SSL.ZeroReturnError:  # the client said goodbye
                self._outer.close()
                return
            self._inner.data_received(data)


class _Plain(asyncio.Transport):
    """A connection as the protocol inside sees it."""

    def __init__(
        self, outer: asyncio.Transport, secured: Secured, chain: tuple[bytes, ...]
    ) -> None:
        super().__init__({CHAIN: chain, "sslcontext": True})
        self._outer, self._secured = outer, secured

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Return what is known of the connection, the client's certificates too."""
        own = super().get_extra_info(name)
        return self._outer.get_extra_info(name, default) if own is None else own

    def write(self, data: bytes | bytearray | memoryview) -> None:
        """Send."""
        self._secured.write(bytes(data))

    def close(self) -> None:
        """End the connection once everything is sent."""
        if not self._outer.is_closing():
            self._secured.say_goodbye()
            self._outer.close()

    def abort(self) -> None:
        """End the connection at once."""
        self._outer.abort()

    def is_closing(self) -> bool:
        """True once it ends."""
        return self._outer.is_closing()

    def pause_reading(self) -> None:
        """Take nothing more for now."""
        self._outer.pause_reading()

    def resume_reading(self) -> None:
        """Go on."""
        self._outer.resume_reading()


def _chain_of(tls: SSL.Connection) -> tuple[bytes, ...]:
    """Return the client's certificates, its own first; empty when none was asked for."""
    own = tls.get_peer_certificate(as_cryptography=True)
    if own is None:
        return ()
    others = tls.get_peer_cert_chain(as_cryptography=True) or []
    ders = [certificate.public_bytes(Encoding.DER) for certificate in (own, *others)]
    # OpenSSL leaves a client's own certificate out of the chain on some sides and not on others
    return tuple(ders[1:] if ders[1:2] == ders[:1] else ders)
