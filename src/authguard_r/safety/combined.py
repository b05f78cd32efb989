# SPDX-License-Identifier: Apache-2.0
"""Several safety gates as one: an action is safe when every one of them says so.

Spec page: docs/spec/safety.md#together
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.facts import SiteFacts
from authguard_r.core.ports import SafetyGate
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.state import AttestedState
from authguard_r.safety.config import MAX_ASKED_MS, SafetyConfig
from authguard_r.safety.envelope import EnvelopeGate
from authguard_r.safety.external import ExternalGate
from authguard_r.safety.temporal.gate import TemporalGate


class Together:
    """Gates that all have to agree (`core.ports.SafetyGate`); none can widen another.

    Args:
        gates: each of them is asked, also when another one refuses. One of them at most remembers.

    Raises:
        ValueError: there is none: no gate would have to agree.
    """

    def __init__(self, *gates: SafetyGate) -> None:
        if not gates:
            raise ValueError("expected a gate")
        self.gates = gates

    def recall(self, memory: bytes) -> Together:
        """Return the gates as of this memory; those that remember nothing leave it alone."""
        return Together(*(gate.recall(memory) for gate in self.gates))

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return the verdict: safe when all say so, else the findings of all.

        Raises:
            RuntimeError: two of the gates remember; what one gave would be given to the other.
        """
        told = [gate.assess(action, state, facts, now) for gate in self.gates]
        if all(one.safe for one in told):
            remembered = [one.memory for one in told if any(one.memory)]
            if len(remembered) > 1:
                raise RuntimeError("two safety gates remember")
            return SafetyDecision(safe=True, memory=remembered[0] if remembered else (b"", b""))
        repair = next((one.repair for one in told if one.repair is not None), None)
        if repair is not None and not all(
            gate.assess(repair, state, facts, now).safe for gate in self.gates
        ):
            repair = None  # one of them would not call it safe
        return SafetyDecision(
            safe=False,
            findings=tuple(finding for one in told for finding in one.findings),
            repair=repair,
        )


def gate_of(config: SafetyConfig, *, asked_ms: int = MAX_ASKED_MS) -> SafetyGate:
    """Return the gate that a configuration asks for: the envelope, and all else that it names.

    Args:
        config: authentic configuration.
        asked_ms: the longest wait for a checker: the decision does nothing else while it waits.

    Raises:
        MalformedError: a rule of it cannot be followed.
        EnvironmentFault: its checker may take longer than there is time.
    """
    gates: list[SafetyGate] = [EnvelopeGate(config)]
    if config.rules:
        gates.append(TemporalGate(config))
    if config.checker is not None:
        if config.checker.timeout_ms > asked_ms:
            raise EnvironmentFault(
                f"expected a checker that answers within {asked_ms} ms here",
                reason=Reason.VALUE_OUT_OF_RANGE,
                where="safety.checker.timeout_ms",
            )
        gates.append(ExternalGate(config.checker))
    return gates[0] if len(gates) == 1 else Together(*gates)
