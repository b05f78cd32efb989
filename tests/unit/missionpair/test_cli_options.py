# SPDX-License-Identifier: Apache-2.0
"""A wrong value of an option is an error of usage that names it, before anything is written."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from fixtures.missionpair_program import told
from missionpair import cli, registry
from missionpair.campaign.log import read_log
from missionpair.registry import OptionError, UnknownNameError
from missionpair.servers import SERVERS

pytestmark = pytest.mark.complete


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--planner", "hijacked", "--attacker", "adaptive"], "`model` is needed"),
        (["--planner", "hijacked", "--attacker", "robopair"], "`model` is needed"),
        (["--planner", "hijacked", "--attacker", "adaptive:model=hijacked"], "`model`: `hijacked`"),
        (["--planner", "hijacked", "--attacker", "search:population=x"], "`population`"),
        (["--planner", "replay"], "`log=FILE`"),
        (["--planner", "graded:susceptibility=zzz"], "`susceptibility`"),
        (["--planner", "graded:preset=zz"], "`preset`"),
        (["--planner", "openai:model=scripted-x,temperature=hot"], "`temperature`"),
        (["--planner", "hijacked", "--defense", "human:first=2"], "`human:first`"),
    ],
)
def test_a_value_that_cannot_be_is_an_error_of_usage_that_names_its_option(
    arguments: list[str],
    said: str,
    few: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = tmp_path / "log"
    code, found = told(capsys, monkeypatch, "run", few, *arguments, "--out", log)
    assert (code, found["error"]["code"]) == (2, "USAGE")
    assert said in found["error"]["message"]
    assert not log.exists()


def test_live_makes_its_attackers_before_it_asks_or_writes_anything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    code, found = told(capsys, monkeypatch, "live", out, "--planner", "hijacked")
    assert (code, found["error"]["code"]) == (2, "USAGE")
    assert "`model`: `hijacked` is no live model" in found["error"]["message"]
    assert not out.exists()


def test_live_strengthens_fixed_texts_over_the_rounds_that_adaptive_ones_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Source: section "Implementation and Experimental Evaluation" (at most three rounds)."""
    with SERVERS["openai"]("resistant") as server:
        model = f"openai:base_url={server.base_url},model=scripted-x"
        code, found = told(
            capsys, monkeypatch, "live", tmp_path / "out", "--planner", model, "--pairs", "1"
        )
    assert code == 0
    logs = {Path(one["log"]).stem: Path(one["log"]) for one in found["campaigns"]}
    assert set(logs) == {"1-openai-fixed", "1-openai-adaptive"}
    for path in logs.values():
        campaign, trials = read_log(path)
        assert campaign.rounds == 3
        assert [len(trial.rounds) for trial in trials] == [3, 3, 3]
    _, (trial, *_) = read_log(logs["1-openai-fixed"])
    one, two, three = (sent.inputs[0][1] for sent in trial.rounds)
    assert two.startswith(f"{one} ")
    assert three.startswith(f"{two} ")


class Refused(registry.SpecificationError):
    """An error of a thing's own."""


@pytest.mark.parametrize(
    ("raised", "seen", "message"),
    [
        (ValueError("`size` is 0"), OptionError, "`thing`: `size` is 0"),
        (UnknownNameError("no such"), UnknownNameError, "no such"),
        (Refused("not here"), Refused, "not here"),
    ],
)
def test_what_a_maker_says_itself_is_told_as_it_is(
    raised: Exception, seen: type[Exception], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def make(*, size: str = "") -> None:
        raise raised

    monkeypatch.setattr(registry, "_module", lambda *_: SimpleNamespace(make=make))
    with pytest.raises(seen) as refused:
        registry.make(cli, "thing:size=0")
    assert type(refused.value) is seen
    assert str(refused.value) == message
    assert "size=0" not in message
