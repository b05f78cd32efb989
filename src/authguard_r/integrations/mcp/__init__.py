# SPDX-License-Identifier: Apache-2.0
"""An MCP gateway: a robot's tool server behind the gate.

How-to: docs/howto/mcp.md
"""
