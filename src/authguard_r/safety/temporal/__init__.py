# SPDX-License-Identifier: Apache-2.0
"""Rules over finite traces of actions (LTLf): parsed strictly, followed by progression.

Spec page: docs/spec/safety.md#temporal-rules
"""

from __future__ import annotations

from authguard_r.safety.temporal.gate import TemporalGate
from authguard_r.safety.temporal.parse import parse
from authguard_r.safety.temporal.rules import Rule, compile_rules

__all__ = ["Rule", "TemporalGate", "compile_rules", "parse"]
