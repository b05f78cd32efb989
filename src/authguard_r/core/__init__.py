# SPDX-License-Identifier: Apache-2.0
"""The trusted core: pure, total, readable in an evening. See docs/explanation/architecture.md.

Internal: it may change in any release.
"""
