# SPDX-License-Identifier: Apache-2.0
"""The audit log: record v1, chain, offline verification.

Internal: it may change in any release.
"""
