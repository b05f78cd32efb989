# SPDX-License-Identifier: Apache-2.0
"""The first hour: a set-up that refuses everything, and proposals from what a robot was seen do.

Untrusted, like drafting: what is written here is a file that a person reads, compiles and signs,
or does not. How-to: docs/howto/onboarding.md
"""
