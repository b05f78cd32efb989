# SPDX-License-Identifier: Apache-2.0
"""A person's key in a plain file is said; a service's is plain on purpose."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from authguard_r.core.quantities import Now
from authguard_r.keys.envelope import seal
from authguard_r.operations.checkup import GateSetup, checkup
from authguard_r.operations.checkup.advice import AdviceCode, Level
from authguard_r.operations.checkup.custody import plain_advice, stray_advice
from fixtures import scenarios

ME = os.geteuid()
SAID = "correct horse battery staple"
PEOPLE = {"operator-1", "supervisor-1", "supervisor-2", "safety-officer-1", "site-authority-1"}
SERVICES = ("gate-", "estimator-", "witness-", "root", "people", "site.", "machines")


@pytest.fixture
def trust(tmp_path: Path) -> Path:
    folder = tmp_path / "trust"
    shutil.copytree(scenarios.trust_folder(), folder)
    return folder


def key_of(trust: Path, name: str) -> Path:
    return trust / "keys" / f"{name}.key.pem"


def told(trust: Path, *, demo: bool, key: Path | None = None) -> set[str]:
    found = checkup(GateSetup(demo=demo, uid=ME, trust=trust, key=key), Now(scenarios.START_MS, 0))
    return {Path(one.place).name for one in found if one.code is AdviceCode.KEY_PLAIN}


def test_each_persons_plain_key_is_warned_of_with_its_mend(trust: Path) -> None:
    path = key_of(trust, "operator-1")
    (found,) = plain_advice(path)
    assert (found.level, found.code, found.place) == (
        Level.WARNING,
        AdviceCode.KEY_PLAIN,
        str(path),
    )
    assert found.mend == f"authguard keys protect {path}"
    assert told(trust, demo=False) >= {f"{name}.key.pem" for name in PEOPLE}
    assert not any(name.startswith(SERVICES) for name in told(trust, demo=False))
    assert told(trust, demo=False, key=path) == told(trust, demo=False)


def test_a_sealed_key_a_services_key_and_no_key_are_not(trust: Path) -> None:
    path = key_of(trust, "operator-1")
    path.write_bytes(seal(path.read_bytes(), SAID))
    assert list(plain_advice(path)) == []
    assert list(plain_advice(key_of(trust, f"gate-{scenarios.RID}"))) == []
    assert list(plain_advice(key_of(trust, "people"))) == []
    assert list(plain_advice(key_of(trust, "nobody"))) == []


def test_a_demonstration_says_it_once_for_all(trust: Path) -> None:
    assert told(trust, demo=True) == set()


def test_a_sealed_key_beside_the_gate_is_a_stray_too(trust: Path) -> None:
    path = key_of(trust, "operator-1")
    path.write_bytes(seal(path.read_bytes(), SAID))
    own = key_of(trust, f"gate-{scenarios.RID}")
    found = {advice.place for advice in stray_advice([trust], own=own, uid=ME)}
    assert str(path) in found
