# SPDX-License-Identifier: Apache-2.0
"""The stop process: a process in which nothing is in the way of a stop, and the gate's end of it.

Internal: it may change in any release.
"""
