# SPDX-License-Identifier: Apache-2.0
"""Coverage-guided fuzzing of the normalizer: what leaves it is a plan or a refusal with a place.

`python3 dev.py fuzz [SECONDS]` runs it for a minute or as long as it is told; a night is better.
The first byte picks the dialect, the rest is the planner's. Anything but an answer or a refusal,
and anything that takes longer than a second, is a finding that atheris saves and reports.
"""

from __future__ import annotations

import sys
from pathlib import Path

import atheris

ROOT = Path(__file__).resolve().parent.parent.parent
SECONDS_FOR_ONE = 1

with atheris.instrument_imports(include=["authguard_r.normalize"]):
    from authguard_r.core.errors import ClarificationError, MalformedError
    from authguard_r.normalize import Binder, Dialect, normalize
    from authguard_r.normalize.binding import load_binding
    from authguard_r.site.source import read_site, read_text, read_yaml

DIALECTS = tuple(Dialect)


def binder() -> Binder:
    """Return the shipped hospital's binder."""
    hospital = ROOT / "examples" / "hospital"
    site = read_site(hospital / "site.yaml")
    plain = read_yaml(read_text(hospital / "binding.yaml"), where="binding")
    return Binder(site, load_binding(plain, site=site, where="binding"))


BINDER = binder()


def one(data: bytes) -> None:
    """Normalize one input."""
    if not data:
        return
    dialect = DIALECTS[data[0] % len(DIALECTS)]
    try:
        plan = normalize(data[1:], binder=BINDER, dialect=dialect)
    except (MalformedError, ClarificationError) as refusal:
        if not refusal.where:
            raise RuntimeError(f"a refusal without a place: {refusal}") from refusal
        return
    if not plan.steps:
        raise RuntimeError("a plan without steps")


def seeds(folder: Path) -> None:
    """Write what planners really say, once for each dialect, as the corpus to start from."""
    folder.mkdir(parents=True, exist_ok=True)
    replies = sorted((ROOT / "examples" / "hospital" / "replies").iterdir())
    for number in range(len(DIALECTS)):
        for reply in replies:
            (folder / f"{number}-{reply.name}").write_bytes(bytes([number]) + reply.read_bytes())


if __name__ == "__main__":
    seconds = sys.argv[1] if len(sys.argv) > 1 else "60"
    corpus = ROOT / "build" / "fuzz"
    seeds(corpus)
    limits = [f"-max_total_time={seconds}", f"-timeout={SECONDS_FOR_ONE}", "-max_len=65536"]
    atheris.Setup([sys.argv[0], *limits, str(corpus)], one)
    atheris.Fuzz()
