# SPDX-License-Identifier: Apache-2.0
"""The one path to the controller: verified inputs, both gates, release, leases, stops, orders.

Internal: it may change in any release.
"""
