# SPDX-License-Identifier: Apache-2.0
"""Decide every recorded action again with the reference, from the log alone."""
