# SPDX-License-Identifier: Apache-2.0
"""What every server of this package at a port has in common: limits, room, patience, and a journal.

Spec page: docs/spec/listeners.md
"""
