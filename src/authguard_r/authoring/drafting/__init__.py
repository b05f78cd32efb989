# SPDX-License-Identifier: Apache-2.0
"""Drafting: from a sentence to a proposal. Untrusted: a proposal authorizes nothing."""
