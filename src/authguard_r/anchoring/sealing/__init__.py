# SPDX-License-Identifier: Apache-2.0
"""Sealed fields of a log: who may read what, in which mission, and until when."""
