# SPDX-License-Identifier: Apache-2.0
"""A gate of a robot whose tools are a package's that has an environment of its own."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import yaml

import worlds
from attesting import attesting
from authguard_r.assembly import demo_members
from authguard_r.keys.setup import init_folder
from authguard_r.site.source import read_site
from authguard_r.site.words import standard_words
from authguard_r.wire.messages import Mode
from gates import PATIENCE_S, RunningGate, environment


@contextmanager
def gate_of(
    folder: Path,
    binding: str | Path,
    *,
    tools: Mapping[str, Sequence[str]] | None = None,
    objects: Mapping[str, Sequence[str]] | None = None,
    beside: Sequence[str] = (),
    grants: Sequence[Mapping[str, Any]] = (),
    profile: Mapping[str, int] | None = None,
    changes: Mapping[str, Any] | None = None,
    mode: Mode = Mode.ENFORCE,
    is_attested: bool = True,
    **bounds: Any,
) -> Iterator[RunningGate]:
    """Yield a gate of the hospital's courier, in the standard words that a binding speaks.

    Args:
        folder: for the site and the keys.
        binding: the planner's tools.
        tools: what this robot can do beside what the hospital's can, by type.
        objects: names of things that the hospital does not have, by identifier.
        beside: types that may run while another action does.
        grants: what its mission grants beside the hospital's.
        profile: what its profile says beside the hospital's.
        changes: fields of the draft of its mission that are not the hospital's.
        mode: it enforces, or only watches.
        is_attested: its state is a test's own; False: somebody else attests it.
        bounds: fields of its configuration that are not as in a fresh set-up.
    """
    plain = yaml.safe_load((worlds.HOSPITAL / "site.yaml").read_text())
    del plain["vocabulary"]
    plain["words"] = "standard"
    known = msgspec.to_builtins(standard_words())
    plain["vocabulary"] = {word: {**known[word], "beside": True} for word in beside}
    for name, names in (objects or {}).items():
        plain["objects"][name] = {"kind": "part", "home": "dock", "mass_g": 1, "names": [*names]}
    plain["robots"][worlds.RID]["profile"] |= profile or {}
    for name, on in (tools or {}).items():
        plain["robots"][worlds.RID]["profile"]["tools"][name] = [*on]
    path, trust = folder / "site.yaml", folder / "trust"
    path.write_text(yaml.safe_dump(plain))
    init_folder(trust, demo_members(read_site(path), (worlds.RID,)), now=datetime.now(UTC))
    made = RunningGate(site=path, trust=trust, binding=Path(binding), mode=mode, **bounds)
    with made, attesting(made) if is_attested else nullcontext() as attested:
        made.move = None if attested is None else attested.move
        draft = worlds.draft("mission.yaml", **(changes or {}))
        given = {"chooser": "operator", "repeat": 20, "starts": 20, "max": "20 s"}
        more = [{**given, "irreversible": False, **grant} for grant in grants]
        risks = draft["risk_policy"]
        types = {**risks["types"], **dict.fromkeys((grant["type"] for grant in grants), 0)}
        classes = {**risks["object_classes"], "part": 0}
        risks = {**risks, "types": types, "object_classes": classes}
        mine = {"grants": [*draft["grants"], *more], "risk_policy": risks}
        mission = made.mission(**{**(changes or {}), **mine})
        made.live = (mission, made.activate(made.token(mission))["digest"])
        yield made


def run_in(
    python: Path, *words: object, variables: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program of another environment to its end; what it loads of ours counts as covered.

    A ROS environment starts itself anew and tells its children that it has: not these.
    """
    mine = {k: v for k, v in environment(measured=True).items() if "ROS_WHEELS" not in k}
    return subprocess.run(
        [python, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
        env={**mine, **(variables or {})},
    )


def asked_in(python: Path, *words: object, **more: Any) -> Any:
    """Return the JSON that a program of another environment prints last."""
    done = run_in(python, *words, **more)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])
