# SPDX-License-Identifier: Apache-2.0
"""What the gate's process and its clients say to each other: frames, and the messages in them.

Internal: it may change in any release.
"""
