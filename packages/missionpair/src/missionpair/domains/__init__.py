# SPDX-License-Identifier: Apache-2.0
"""The domains: one file each, found by its name; `make()` returns the domain's words.

How to add one: docs/howto/missionpair-extend.md
"""
