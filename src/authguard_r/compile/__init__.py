# SPDX-License-Identifier: Apache-2.0
"""The mission compiler: draft to mission, review card, and the smallest signed change."""
