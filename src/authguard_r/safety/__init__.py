# SPDX-License-Identifier: Apache-2.0
"""The second gate G_S: physical safety, with its own signed configuration and its own words.

It knows nothing of missions. It can accept what a mission forbids and forbid what one allows;
only both together let an action through. Source: `eq:execute`. Spec page: docs/spec/safety.md
"""

from __future__ import annotations

from authguard_r.safety.config import SafetyConfig, default_config, open_config, safety_digest
from authguard_r.safety.envelope import EnvelopeGate

__all__ = ["EnvelopeGate", "SafetyConfig", "default_config", "open_config", "safety_digest"]
