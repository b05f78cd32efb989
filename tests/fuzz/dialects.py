# SPDX-License-Identifier: Apache-2.0
"""Coverage-guided fuzzing of the normalizer: what leaves it is a plan or a refusal with a place.

`python3 dev.py fuzz [SECONDS]` runs it for a minute or as long as it is told; a night is better.
The first byte picks the dialect, the second the binding, the rest is the planner's. Anything but
an answer or a refusal, and anything that takes longer than a second, is a finding that atheris
saves and reports.
"""

from __future__ import annotations

import sys
from pathlib import Path

import atheris

ROOT = Path(__file__).resolve().parent.parent.parent
SECONDS_FOR_ONE = 1

with atheris.instrument_imports(include=["authguard_r.normalize"]):
    from authguard_r.authoring.binding.samples import probe_site
    from authguard_r.core.errors import ClarificationError, MalformedError
    from authguard_r.normalize import Binder, Dialect, read_plan
    from authguard_r.normalize.binding import Binding, load_binding
    from authguard_r.normalize.shipped import binding_source, shipped_names
    from authguard_r.site.source import convert, read_site, read_text, read_yaml
    from authguard_r.site.words import standard_words

sys.path.insert(0, str(ROOT / "tests"))
from unit.normalize.writers import WAYS  # noqa: E402 - after the instrumented imports

DIALECTS = tuple(Dialect)


def hospital() -> Binder:
    """Return the shipped hospital's binder."""
    folder = ROOT / "examples" / "hospital"
    site = read_site(folder / "site.yaml")
    plain = read_yaml(read_text(folder / "binding.yaml"), where="binding")
    return Binder(site, load_binding(plain, site=site, where="binding"))


def shipped(name: str) -> Binder:
    """Return the binder of a shipped binding at a small site of its own."""
    binding = convert(binding_source(name), Binding, where=name)
    return Binder(probe_site(binding, standard_words()), binding)


BINDERS = (hospital(), *map(shipped, shipped_names()))


def one(data: bytes) -> None:
    """Normalize one input."""
    if len(data) < 2:
        return
    dialect, binder = DIALECTS[data[0] % len(DIALECTS)], BINDERS[data[1] % len(BINDERS)]
    try:
        plan = read_plan(data[2:], binder=binder, dialect=dialect)
    except (MalformedError, ClarificationError) as refusal:
        if not refusal.where:
            raise RuntimeError(f"a refusal without a place: {refusal}") from refusal
        return
    if not plan.steps:
        raise RuntimeError("a plan without steps")


def seeds(folder: Path) -> None:
    """Write what planners really say, in every dialect, as the corpus to start from."""
    folder.mkdir(parents=True, exist_ok=True)
    replies = sorted((ROOT / "examples" / "hospital" / "replies").iterdir())
    said = {reply.name: (Dialect.AUTO, reply.read_bytes()) for reply in replies}
    said |= {name: (d, write(*calls).encode()) for name, (d, write, calls) in WAYS.items()}
    for name, (dialect, text) in said.items():
        for number in range(len(BINDERS)):
            start = bytes([DIALECTS.index(dialect), number])
            (folder / f"{number}-{name}").write_bytes(start + text)


if __name__ == "__main__":
    seconds = sys.argv[1] if len(sys.argv) > 1 else "60"
    corpus = ROOT / "build" / "fuzz"
    seeds(corpus)
    limits = [f"-max_total_time={seconds}", f"-timeout={SECONDS_FOR_ONE}", "-max_len=65536"]
    atheris.Setup([sys.argv[0], *limits, str(corpus)], one)
    atheris.Fuzz()
