# SPDX-License-Identifier: Apache-2.0
"""The mission compiler: draft to mission or questions, lint, card, comparison, confirmation."""
