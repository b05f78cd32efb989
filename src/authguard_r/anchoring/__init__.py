# SPDX-License-Identifier: Apache-2.0
"""How a store that was put back is known: by what is kept outside of it.

Spec page: docs/spec/rollback.md

Internal: it may change in any release.
"""
