# SPDX-License-Identifier: Apache-2.0
"""Sealed fields of a log: who may read what, in which mission, and until when."""

from authguard_r.sealing.policy import (
    Reader,
    Retention,
    SealingPolicy,
    require_readers,
    require_retention,
)
from authguard_r.sealing.ring import KeyRing

__all__ = [
    "KeyRing",
    "Reader",
    "Retention",
    "SealingPolicy",
    "require_readers",
    "require_retention",
]
