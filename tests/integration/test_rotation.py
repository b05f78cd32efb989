# SPDX-License-Identifier: Apache-2.0
"""Keys and lists change while a gate runs and a planner proposes: nothing that is right is refused.

Real processes: gate, stop lane, robot, estimators. One set-up whose folder the gate reads, and
`auth` beside it, the authority's own.
"""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.cli import call
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import read_signer
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, until

#: Decisions that have to lie between two steps of a rotation.
_BETWEEN = 5


class Planner:
    """Proposes one harmless step after another, until it is told to end."""

    def __init__(self, gate: RunningGate) -> None:
        self.decided: list[dict[str, Any]] = []
        self._client = gate.client(ClientRole.PLANNER, "rotates")
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._error: BaseException | None = None
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._over.is_set():
                self.decided += self._client.propose(b"scan()")["steps"]
        except BaseException as error:  # noqa: BLE001 - the test says it
            self._error = error

    def goes_on(self) -> None:
        """Wait for some more decisions."""
        least = len(self.decided) + _BETWEEN
        until(lambda: self._error or len(self.decided) >= least, "decisions")
        assert self._error is None

    def refused(self) -> list[dict[str, Any]]:
        return [step for step in tuple(self.decided) if not step["released"]]

    def end(self) -> None:
        self._over.set()
        self._thread.join(30)
        assert not self._thread.is_alive()
        assert self._error is None


class Site:
    """The machines of a set-up, and the commands that are given on them."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.trust, self.auth, self.new = folder / "trust", folder / "auth", folder / "new"
        init_folder(
            self.trust, demo_members(scenarios.site(), (scenarios.RID,)), now=datetime.now(UTC)
        )
        shutil.copytree(self.trust, self.auth)
        self._capsys = capsys

    def run(self, *words: object) -> Any:
        assert call([*map(str, words), "--json"]) == 0, self._capsys.readouterr()
        return json.loads(self._capsys.readouterr().out)

    def old(self, name: str) -> tuple[Path, Path]:
        return self.trust / f"keys/{name}.key.pem", self.trust / f"keys/{name}.cert.pem"

    def serial(self, name: str) -> str:
        shown = self.run("keys", "show", self.trust)["principals"]
        return next(str(item["serial"]) for item in shown if item["principal"] == name)

    def rotate(self, name: str) -> tuple[Path, Path]:
        """Return the files of the name's next key; the one before still counts."""
        key, cert = self.old(name)
        words = ("--key", key, "--cert", cert, "--trust", self.trust, "--out", self.new)
        made = self.run("keys", "rotate", *words)
        answer = self.run("keys", "issue", self.auth, made["request"], "--yes")["answer"]
        words = ("--key", made["key"], "--trust", self.trust)
        told = self.run("keys", "install", answer, *words)
        return Path(made["key"]), Path(told["cert"])

    def revoke(self, gate: RunningGate, *who: object) -> None:
        """Revoke at the authority and bring the list to the gate and its folder."""
        for item in self.run("keys", "revoke", self.auth, *who)["lists"]:
            self.bring(gate, Path(item["file"]))

    def bring(self, gate: RunningGate, *files: Path) -> None:
        words = ("--gate", gate.run, "--trust", self.trust)
        self.run("advanced", "revocations", "install", *files, *words)


@pytest.fixture
def site(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Site:
    return Site(tmp_path, capsys)


@pytest.fixture
def gate(site: Site) -> Iterator[RunningGate]:
    fast = ("--speed-up", "50")
    with RunningGate(robot=fast, estimator=("--rate", "50"), trust=site.trust) as made:
        yield made


def patient(gate: RunningGate) -> Mission:
    """Return the shipped mission with room for a long row of scans."""
    plain = scenarios.draft()
    grants = [
        {**grant, "repeat": 9_000, "starts": 9_000} if grant["id"] == "look-out" else grant
        for grant in plain["grants"]
    ]
    rate = {"count": 9_000, "per": "10 s"}
    return gate.mission(grants=grants, budgets={**plain["budgets"], "actions": 9_000, "rate": rate})


def test_nothing_is_refused_while_operator_estimator_and_lists_change(
    site: Site, gate: RunningGate
) -> None:
    mission = patient(gate)
    gate.activate(sign_object(mission, Tag.MISSION, read_signer(*site.old("operator-1"))))
    old = gate._started["estimator"]
    planner = Planner(gate)
    try:
        planner.goes_on()
        # the operator: a new key signs the next version before the old key is dead
        signer = read_signer(*site.rotate("operator-1"))
        planner.goes_on()
        after = replace(mission, version=2, supersedes=digest_of(Tag.MISSION, mission))
        gate.activate(sign_object(after, Tag.MISSION, signer))
        planner.goes_on()
        site.revoke(gate, "--serial", site.serial("operator-1"))
        planner.goes_on()
        # the estimator: the new one speaks before the old one ends
        key, cert = site.rotate(f"estimator-{scenarios.RID}")
        words = ("--robot", scenarios.RID, "--gate", gate.run, "--trust", site.trust)
        gate.launch("estimator", *words, "--rate", "50", "--key", key, "--cert", cert)
        gate.ready("estimator")
        planner.goes_on()
        old.terminate()
        assert old.wait(30) == 0
        site.revoke(gate, "--serial", site.serial(f"estimator-{scenarios.RID}"))
        planner.goes_on()
        # every list anew, before any is stale
        lists = site.run("keys", "lists", site.auth, "--days", "7")["lists"]
        site.bring(gate, *(Path(item["file"]) for item in lists))
        planner.goes_on()
    finally:
        if old.poll() is None:
            old.kill()
            old.wait()
        planner.end()
    assert planner.refused() == []
    assert len(planner.decided) >= 6 * _BETWEEN
    told = [
        (r.open["authority"], r.open["number"]) for r in gate.records() if r.kind == "revocation"
    ]
    assert told[:2] == [("people", 2), ("machines", 2)]
    assert set(told[2:]) == {("root", 2), ("people", 3), ("site", 2), ("machines", 3)}


@pytest.mark.smoke
def test_the_first_decision_after_a_list_is_refused(site: Site, gate: RunningGate) -> None:
    gate.activate(sign_object(patient(gate), Tag.MISSION, read_signer(*site.old("operator-1"))))
    planner = Planner(gate)
    planner.goes_on()
    site.revoke(gate, "operator-1")
    planner.goes_on()
    planner.end()
    # a refusal may wait for the next commit
    until(lambda: "refusal" in {r.kind for r in gate.records()}, "the record of a refusal")
    log = [r for r in gate.records() if r.kind in {"decision", "revocation", "refusal"}]
    at = [r.kind for r in log].index("revocation")
    assert {(r.kind, r.decision) for r in log[:at]} == {("decision", "accept")}
    assert {r.kind for r in log[at + 1 :]} == {"refusal"}
    assert {code for r in log[at + 1 :] for code in r.reasons} == {"CERTIFICATE_REVOKED"}
    first = next(n for n, step in enumerate(planner.decided) if not step["released"])
    assert first == at  # every decision before it was an acceptance, and none after it is
    assert not any(step["released"] for step in planner.decided[first:])
    with pytest.raises(AuthenticityError, match="revoked"):
        gate.activate(sign_object(patient(gate), Tag.MISSION, read_signer(*site.old("operator-1"))))


def test_a_gate_takes_its_new_key_with_a_restart(site: Site, gate: RunningGate) -> None:
    """The mission goes on; controller, estimator and clients come back by themselves."""
    gate.activate(sign_object(patient(gate), Tag.MISSION, read_signer(*site.old("operator-1"))))
    planner = Planner(gate)
    planner.goes_on()
    planner.end()
    assert planner.refused() == []
    name = f"gate-{scenarios.RID}"
    key, cert = site.rotate(name)
    gate.stop_process("gate")
    gate.start_gate("--key", str(key), "--cert", str(cert))
    site.revoke(gate, "--serial", site.serial(name))

    def goes_on() -> bool:
        with gate.client(ClientRole.PLANNER, "again") as client:
            (step,) = client.propose(b"scan()")["steps"]
        return bool(step["released"] and step["execution"]["outcome"] == "succeeded")

    until(goes_on, "a release by the gate with its new key")
    verbs = [r.decision for r in gate.records() if r.kind == "management"]
    assert verbs == ["issue", "activate"]  # nobody had to resume it
    # with the old key no gate starts any more: the folder has the list, and the store too
    gate.stop_process("gate")
    with pytest.raises(AssertionError, match="CERTIFICATE_REVOKED"):
        gate.start_gate()
