# SPDX-License-Identifier: Apache-2.0
"""The safety gate's configuration, opened: signed by a safety officer, and each rule sound."""

from __future__ import annotations

from authguard_r.core.encoding import Tag
from authguard_r.core.principals import Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.token import open_token
from authguard_r.safety.config import SafetyConfig
from authguard_r.safety.temporal.rules import compile_rules

#: Who signs one.
CONFIG_ROLES = frozenset({"safety_officer"})


def open_config(data: bytes, *, verifier: Verifier, now: Now) -> SafetyConfig:
    """Return the configuration in a token signed by a safety officer.

    Raises:
        MalformedError: no canonical configuration, or a rule in it that cannot be followed.
        AuthenticityError: certificate, signature or role does not hold.
    """
    config, _, _ = open_token(
        data,
        SafetyConfig,
        tag=Tag.SAFETY,
        roles=CONFIG_ROLES,
        verifier=verifier,
        now=now,
    )
    compile_rules(config.rules)
    return config
