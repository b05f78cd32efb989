# SPDX-License-Identifier: Apache-2.0
"""FROST(Ed25519, SHA-512), RFC 9591: t of n people make one plain Ed25519 signature.

For signers' machines only; a gate verifies the signature like any other and never imports this.
Needs the extra `frost`. Spec page: docs/spec/frost.md

Internal: it may change in any release.
"""
