# SPDX-License-Identifier: Apache-2.0
"""The second gate G_S: physical safety, with its own signed configuration and its own words.

It knows nothing of missions. It can accept what a mission forbids and forbid what one allows;
only both together let an action through. Source: `eq:execute`. Spec page: docs/spec/safety.md

Internal: it may change in any release.
"""

from __future__ import annotations

from authguard_r.safety.combined import Together, gate_of
from authguard_r.safety.config import (
    ExternalChecker,
    Rule,
    SafetyConfig,
    default_config,
    safety_digest,
)
from authguard_r.safety.envelope import EnvelopeGate
from authguard_r.safety.external import ExternalGate
from authguard_r.safety.signed import open_config
from authguard_r.safety.temporal import TemporalGate

__all__ = [
    "EnvelopeGate",
    "ExternalChecker",
    "ExternalGate",
    "Rule",
    "SafetyConfig",
    "TemporalGate",
    "Together",
    "default_config",
    "gate_of",
    "open_config",
    "safety_digest",
]
