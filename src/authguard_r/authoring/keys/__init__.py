# SPDX-License-Identifier: Apache-2.0
"""Issue, renew and revoke certificates, and set up trust folders."""
