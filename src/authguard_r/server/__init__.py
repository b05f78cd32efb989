# SPDX-License-Identifier: Apache-2.0
"""The gate as a process: one enforcer, many clients, a stop process of its own.

Internal: it may change in any release.
"""
