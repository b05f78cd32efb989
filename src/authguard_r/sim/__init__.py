# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot and its world in time; implements the controller and state ports.

Internal: it may change in any release.
"""
