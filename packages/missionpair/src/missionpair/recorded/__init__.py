# SPDX-License-Identifier: Apache-2.0
"""What language models did, recorded elsewhere: read, and put to defenses again."""
