# SPDX-License-Identifier: Apache-2.0
"""Agents of a Python process, with its functions behind a gate.

How-to: docs/howto/adapters.md
"""

from __future__ import annotations

from authguard_r.integrations.functions.guard import GateGuard
from authguard_r.integrations.functions.outcomes import Failed, NotDone, Refused, Repeated

__all__ = ["Failed", "GateGuard", "NotDone", "Refused", "Repeated"]
