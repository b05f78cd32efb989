# SPDX-License-Identifier: Apache-2.0
"""What everything has in common that drives a robot by calls of tools.

Spec page: docs/spec/adapters.md#ends
"""
