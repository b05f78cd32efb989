# SPDX-License-Identifier: Apache-2.0
"""Derive a template from a draft, and show its signer every form that a mission of it can take."""
