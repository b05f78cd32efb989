# SPDX-License-Identifier: Apache-2.0
"""Twins: for each category one file that changes a step of a mission, safely and without right.

A module's `make()` returns its `Twins`. How to add one: docs/howto/missionpair-extend.md
"""
