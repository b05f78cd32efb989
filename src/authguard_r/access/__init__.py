# SPDX-License-Identifier: Apache-2.0
"""Who may connect to a gate and as which role: configuration, peer credentials, handshake.

Internal: it may change in any release.
"""
