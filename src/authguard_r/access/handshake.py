# SPDX-License-Identifier: Apache-2.0
"""The answer of a gate or of its stop process to a hello, with the proof that it asks for.

Spec page: docs/spec/gate-protocol.md#proof
"""

from __future__ import annotations

from msgspec import UNSET, UnsetType

from authguard_r.access.gate_config import GateConfig
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import Digest
from authguard_r.core.principals import Signer
from authguard_r.core.token import sign_object
from authguard_r.wire.messages import PROTOCOL, Hello, Proof, Welcome


def welcome_of(
    hello: Hello,
    config: GateConfig,
    signer: Signer,
    *,
    site: Digest | None = None,
    binding: Digest | UnsetType = UNSET,
) -> Welcome:
    """Return the welcome of a hello that is taken.

    Args:
        hello: as it came.
        config: the signed configuration.
        signer: the gate's own key.
        site: digest of the site model; None of the stop process, which knows none.
        binding: digest of the binding; not said by the stop process.
    """
    proof = None
    if hello.nonce is not None:
        said = Proof(robot=config.robot, role=hello.role, nonce=hello.nonce)
        proof = sign_object(said, Tag.HANDSHAKE, signer).decode("ascii")
    return Welcome(
        protocol=PROTOCOL,
        robot=config.robot,
        mode=config.mode,
        role=hello.role,
        client=hello.client,
        site=site,
        binding=binding,
        proof=proof,
    )
