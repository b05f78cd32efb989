# SPDX-License-Identifier: Apache-2.0
"""What people do before they sign: drafts, compiling, cards, importers, templates, issuing keys.

Internal: it may change in any release.
"""
