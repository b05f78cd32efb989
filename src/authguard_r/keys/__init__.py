# SPDX-License-Identifier: Apache-2.0
"""Keys, certificates, trust roots and revocation: steps 1 and 2 of `alg:authguard`.

Internal: it may change in any release.
"""
