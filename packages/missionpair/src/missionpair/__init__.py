# SPDX-License-Identifier: Apache-2.0
"""MissionPAIR: attacks that are safe and unauthorized, and how many of them get through."""
