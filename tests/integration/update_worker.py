# SPDX-License-Identifier: Apache-2.0
"""A gate's process that dies in the middle of a mission's update, without a word.

Called with the trust folder, the store, the token's file, the instant, and the step after which
it dies: a method of `Transaction`, or `afterwards`.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from authguard_r.operations.simulation import simulate
from authguard_r.store.transactions import Transaction
from fixtures import scenarios

DEAD = 9


def main(folder: str, store: str, token: str, start_ms: str, step: str) -> None:
    simulation = simulate(
        Path(folder),
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=int(start_ms),
        store=Path(store),
    )
    if step != "afterwards":
        carried_out = getattr(Transaction, step)

        def dies(act: Transaction, *arguments: Any) -> None:
            carried_out(act, *arguments)
            os._exit(DEAD)

        setattr(Transaction, step, dies)
    simulation.gate.management.activate(Path(token).read_bytes())
    os._exit(DEAD)


if __name__ == "__main__":
    main(*sys.argv[1:])
