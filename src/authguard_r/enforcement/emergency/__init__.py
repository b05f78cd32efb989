# SPDX-License-Identifier: Apache-2.0
"""What a robot may do in an emergency: a policy of its own, apart from every mission.

Narrow capabilities with nothing left open, each guarded by attested state, each saying what it
works without. Nothing is dispatched here: `authguard_r.enforcement.emergency_enforcer` dispatches.
Spec page: docs/spec/emergency.md
"""
