# SPDX-License-Identifier: Apache-2.0
"""Requests to a language model's server, for drafting and for MissionPAIR's planners.

`exchange` sends one request and bounds it. `protocols` knows the two protocols. Nothing here trusts
a reply: the callers hold it to a strict schema.
"""
