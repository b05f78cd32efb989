# SPDX-License-Identifier: Apache-2.0
"""Signs as pictures and sentences as sound: what a robot reads and hears of an attack's texts.

A suite that was perceived holds what was read and heard, so that a run needs none of these tools.
Spec page: docs/spec/missionpair.md#perception
"""

from missionpair.perception.making import Perception, is_perceivable, perceive
from missionpair.perception.tools import PerceptionError

__all__ = ["Perception", "PerceptionError", "is_perceivable", "perceive"]
