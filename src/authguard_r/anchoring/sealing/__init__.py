# SPDX-License-Identifier: Apache-2.0
"""Sealed fields of a log: who may read what, in which mission, and until when."""

from authguard_r.anchoring.sealing.key_ring import KeyRing
from authguard_r.anchoring.sealing.policy import (
    Reader,
    Retention,
    SealingPolicy,
    require_readers,
    require_retention,
)

__all__ = [
    "KeyRing",
    "Reader",
    "Retention",
    "SealingPolicy",
    "require_readers",
    "require_retention",
]
