# SPDX-License-Identifier: Apache-2.0
"""The test runner: groups of tests, the environments that they need, records, and mutants.

`python3 dev.py test` and `python3 dev.py mutants` call it. CONTRIBUTING.md explains its use.
"""
