# SPDX-License-Identifier: Apache-2.0
"""Stores: SQLite for robots, memory for what-ifs; one Protocol, one conformance suite.

Internal: it may change in any release.
"""
