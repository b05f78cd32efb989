# SPDX-License-Identifier: Apache-2.0
"""Check a binding: what it lets through, shown on sample calls."""
