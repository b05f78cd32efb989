# SPDX-License-Identifier: Apache-2.0
"""Who may ask: who knows the token, or shows a certificate of the trust set-up, or has to do both.

Spec page: docs/spec/http.md#who-may-ask
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from authguard_r.core.errors import AuthenticityError, AuthGuardError, EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.integrations.http.faults import RequestError, of_away
from authguard_r.integrations.http_listener.access import shows
from authguard_r.integrations.http_listener.connection import CHAIN
from authguard_r.keys.certificate import Role
from authguard_r.keys.trust import Trust

#: Who may ask by default.
ROLES = frozenset({Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER})
#: Certificates that no longer hold, or never did: show another one.
_UNKNOWN = {"www-authenticate": "Bearer"}


class Certificates:
    """Holds clients' certificates to the trust set-up, anew for each request.

    Args:
        trust: reads the trust root; a revocation counts from the next request on.
        robot: which a client's certificate has to be for.
        roles: which it has to be of.
        now: reads the clocks.
    """

    def __init__(
        self,
        trust: Callable[[], Trust],
        robot: RobotId,
        roles: frozenset[Role],
        now: Callable[[], Now],
    ) -> None:
        self._trust, self._robot, self._roles, self._now = trust, robot, roles, now

    def require_usable(self) -> None:
        """Require one root, of Ed25519: one certificate of a client's is all that TLS shows.

        Raises:
            EnvironmentFault: the set-up has two, or another algorithm.
        """
        self._usable()

    def who(self, chain: tuple[bytes, ...]) -> str:
        """Return whose certificate it is.

        Args:
            chain: leaf and authority; TLS has seen that the client holds the leaf's key.

        Raises:
            RequestError: it is not valid (401), or not for this (403); or that is unknown (503).
        """
        try:
            leaf = self._usable().identify(chain, self._now())
        except AuthenticityError as error:
            raise _unknown(error) from error
        except AuthGuardError as error:
            raise of_away(error) from error
        if leaf.role not in self._roles:
            text = f"a `{leaf.role}` may not ask here"
            raise RequestError(403, str(Reason.ROLE_DENIED), text, where="certificate")
        if not leaf.scope.covers(self._robot):
            text = "the certificate is not for this robot"
            raise RequestError(403, str(Reason.SIGNER_OUT_OF_SCOPE), text, where="certificate")
        return leaf.principal

    def _usable(self) -> Trust:
        trust = self._trust()
        roots = trust.roots
        if len(roots) != 1 or not isinstance(roots[0].public_key(), Ed25519PublicKey):
            raise EnvironmentFault(
                "client certificates need one Ed25519 root; with this set-up use --token-file",
                reason=Reason.CERTIFICATE_INVALID,
                where="--client-certificates",
            )
        return trust


class Authenticator:
    """Lets in only a caller who has shown all that is asked for.

    Args:
        token: the bearer token; None: none is asked for.
        certificates: what clients' certificates are held to; None: none is asked for.
    """

    def __init__(self, token: bytes | None, certificates: Certificates | None) -> None:
        if token is None and certificates is None:
            raise ValueError("expected a token or client certificates")
        self._token, self._certificates = token, certificates

    def admit(self, scope: Any) -> str:
        """Return who asks.

        Args:
            scope: of the request.

        Raises:
            RequestError: the caller may not.
        """
        if self._token is not None and not shows(scope["headers"], self._token):
            text = "expected `Authorization: Bearer TOKEN`, once"
            raise RequestError(401, "TOKEN_INVALID", text, where="authorization", headers=_UNKNOWN)
        if self._certificates is None:
            return "token"
        return self._certificates.who(scope.get(CHAIN, ()))


def _unknown(error: AuthenticityError) -> RequestError:
    return RequestError(
        401, str(error.reason), error.message, where="certificate", headers=_UNKNOWN
    )
