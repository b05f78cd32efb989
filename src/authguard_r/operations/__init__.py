# SPDX-License-Identifier: Apache-2.0
"""What an administrator asks: is this set-up safe, what is its state, what should be done next.

Internal: it may change in any release.
"""
