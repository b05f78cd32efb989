# SPDX-License-Identifier: Apache-2.0
"""Check a store or an export as a stranger: verify it, decide again with the reference, explain.

Internal: it may change in any release.
"""
