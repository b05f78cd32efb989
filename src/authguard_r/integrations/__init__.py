# SPDX-License-Identifier: Apache-2.0
"""Adapters between a gate and other software: ROS 2, MCP, HTTP, agent frameworks.

An adapter is a client of the gate. It decides nothing.
"""
