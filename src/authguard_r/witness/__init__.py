# SPDX-License-Identifier: Apache-2.0
"""A witness: signs a log's checkpoint only when it follows from the last one that it signed.

A program of its own, on a machine or at least under a user that no gate can write. The gate speaks
to it over HTTP and imports nothing of it. Spec page: docs/spec/witness.md

Internal: it may change in any release.
"""
