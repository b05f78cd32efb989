# SPDX-License-Identifier: Apache-2.0
"""What a gate is started with, held against what its store has seen before.

Spec page: docs/spec/gate-protocol.md#configuration
"""

from __future__ import annotations

from authguard_r.audit.record import NONE
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.enforcement.management import Management
from authguard_r.enforcement.management.configurations import Configuration, ConfiguredPart
from authguard_r.normalize.binding import binding_digest
from authguard_r.safety import safety_digest
from authguard_r.server.parts import GateParts


def hold_configured(parts: GateParts, management: Management) -> None:
    """Hold what is in force: nothing signed goes back, and each change is recorded.

    Raises:
        RefusedError: a signed part is older than one that was in force here.
    """
    config, safety, emergency = parts.config, parts.safety, Configuration(digest=NONE)
    if parts.emergency is not None:
        opened = parts.emergency.policy
        emergency = Configuration(digest=opened.digest, version=opened.policy.version)
    configured = {
        ConfiguredPart.BINDING: Configuration(digest=binding_digest(parts.binding)),
        ConfiguredPart.EMERGENCY: emergency,
        ConfiguredPart.GATE: Configuration(
            digest=digest_of(Tag.GATE, config), version=config.version
        ),
        ConfiguredPart.SAFETY: Configuration(digest=safety_digest(safety), version=safety.version),
    }
    management.require_configurations(configured)  # while the clock is behind, too
    management.hold_policy(parts.risk)
    management.hold_configurations(configured, sealed={ConfiguredPart.SAFETY: {"safety": safety}})
