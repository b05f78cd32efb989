# SPDX-License-Identifier: Apache-2.0
"""The people of `authguard run`: they see each approval request and sign their answers here.

How-to: docs/howto/approvals.md
"""

from __future__ import annotations

from pathlib import Path

import typer
from msgspec import Struct

from authguard_r.authoring.compile.request import card
from authguard_r.cli.signing_key import open_signer
from authguard_r.client.approvals import shown, signed_answer
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.decision import Verdict
from authguard_r.enforcement.report import Report
from authguard_r.keys.certificate import read_claims
from authguard_r.keys.signer import FileSigner
from authguard_r.operations.simulation import Simulation
from authguard_r.server.approval_requests import OpenQuestions
from authguard_r.wire.output import printed


class Approvers(Struct, frozen=True, kw_only=True):
    """The keys that may answer approval requests during `run`.

    Args:
        signers: one for each approver, with the certificates beside the key.
        yes: sign each request without a question.
        quiet: standard output belongs to JSON; people read standard error.
    """

    signers: tuple[FileSigner, ...] = ()
    yes: bool = False
    quiet: bool = False

    def answered(self, simulation: Simulation, report: Report) -> bool:
        """Collect the answers to the request that stopped a step; True: propose the step again.

        Args:
            simulation: the gate that asks.
            report: the step's result.

        Raises:
            AuthGuardError: the request's bytes are damaged, or a signature is not authentic.
            typer.Abort: standard input ended.
        """
        judged = report.judged
        asks = judged is not None and judged.decision.verdict is Verdict.REQUEST_APPROVAL
        match = judged.decision.match if asks and judged is not None else None
        if match is None or not self.signers:
            return False
        requests = OpenQuestions(simulation.gate, lambda _: None)
        grant = match.indexed.grant.id
        question = next(item for item in requests.told(None).requests if item.grant == grant)
        lines = card(question, shown(question), simulation.robot.site)
        self._say(*lines)
        signed = False
        for signer in self.signers:
            name = read_claims(signer.chain[0]).principal
            if not (self.yes or typer.confirm(f"Approve exactly this as {name}?", err=self.quiet)):
                self._say(f"request {question.counter}: {name} does not answer")
                continue
            token = signed_answer(question, ApprovalVerdict.APPROVE, signer).token
            why = requests.answered(simulation.gate.management.approve(token))["why_not"]
            counts = f", but it does not count: {why}" if why else ""
            self._say(f"request {question.counter}: {name} approves{counts}")
            signed = True
        return signed

    def _say(self, *lines: str) -> None:
        for line in lines:
            typer.echo(printed(line), err=self.quiet)


def approvers(keys: list[Path] | None, *, yes: bool, as_json: bool) -> Approvers:
    """Return the approvers whose keys were named; a sealed key asks for its passphrase now.

    Raises:
        AuthGuardError: a key cannot be opened or is not its certificate's.
    """
    signers = tuple(open_signer(key) for key in keys or ())
    return Approvers(signers=signers, yes=yes, quiet=as_json)


def next_step(report: Report) -> list[str]:
    """Say how a step that waits for approval goes on; nothing for other steps."""
    judged = report.judged
    if judged is None or judged.decision.verdict is not Verdict.REQUEST_APPROVAL:
        return []
    return ["  to collect the approvals, add --approver NAME.key.pem for each approver"]
