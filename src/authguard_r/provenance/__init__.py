# SPDX-License-Identifier: Apache-2.0
"""What the planner has seen: the context ledger, mentions in texts, the label of each field.

Internal: it may change in any release.
"""
