# SPDX-License-Identifier: Apache-2.0
"""The reference oracle: a literal transcription of the paper and docs/spec, standard library only.

`alg:authguard` and `eq:auth-predicate` in `policy`, `grants`, `place` and `standing`;
`eq:threshold` in `risk`, `approval` and `people`; `eq:trace-auth` in `lease`; `eq:trace-safe` in
`safety`; `eq:action-deviation` and `eq:plan-deviation` in `deviation`; `eq:scmh`, `eq:uasr`,
`eq:scmhr` and `eq:su` in `metrics`; `eq:log` in `chain`. It imports nothing of the gate it is
compared with.
"""

from authguard_reference.chain import canonical, digest, link
from authguard_reference.deviation import action_deviation, plan_deviation
from authguard_reference.lease import permit, still
from authguard_reference.metrics import btcr, frr, scmh, scmhr, su, uasr, wilson
from authguard_reference.policy import authorized, decide
from authguard_reference.reasons import DECIDED, ORDER
from authguard_reference.safety import hazards, safe
from authguard_reference.standing import TRANSITIONS, is_complete, release, settle

__all__ = [
    "DECIDED",
    "ORDER",
    "TRANSITIONS",
    "action_deviation",
    "authorized",
    "btcr",
    "canonical",
    "decide",
    "digest",
    "frr",
    "hazards",
    "is_complete",
    "link",
    "permit",
    "plan_deviation",
    "release",
    "safe",
    "scmh",
    "scmhr",
    "settle",
    "still",
    "su",
    "uasr",
    "wilson",
]
