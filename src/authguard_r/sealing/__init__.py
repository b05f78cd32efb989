# SPDX-License-Identifier: Apache-2.0
"""Sealed fields of a log: who may read what, in which mission, and until when."""

from authguard_r.sealing.policy import (
    Reader,
    Retention,
    SealingPolicy,
    policy_of,
    require_readers,
    require_retention,
)
from authguard_r.sealing.ring import KeyRing
from authguard_r.sealing.sealer import Sealer

__all__ = [
    "KeyRing",
    "Reader",
    "Retention",
    "Sealer",
    "SealingPolicy",
    "policy_of",
    "require_readers",
    "require_retention",
]
