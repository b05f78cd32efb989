# SPDX-License-Identifier: Apache-2.0
"""Running a campaign: its trials, its processes, and the one log that it writes."""
