# SPDX-License-Identifier: Apache-2.0
"""The site model: regions, objects, robots, words; from YAML to `SiteFacts`.

Internal: it may change in any release.
"""
