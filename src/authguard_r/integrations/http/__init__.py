# SPDX-License-Identifier: Apache-2.0
"""The HTTP decision point: a gate's what-if for enforcement points that speak OpenID AuthZEN.

Spec page: docs/spec/http.md
"""
