# SPDX-License-Identifier: Apache-2.0
"""Works on a store's file: no process holds it, and its counter is named where it has one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from msgspec import Struct

from authguard_r.cli.gateway import beside_store, told_of
from authguard_r.cli.inputs import gate_robot, load_site
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason

if TYPE_CHECKING:  # loaded when a store is opened
    from authguard_r.anchoring.counter import Counter
    from authguard_r.server.wiring import Gate

CounterOption = Annotated[
    Path | None,
    typer.Option("--counter", help="The file of the store's outside counter."),
]
NewOption = Annotated[bool, typer.Option("--new", help="Create the store if it does not exist.")]


class OfflineStore(Struct, frozen=True, kw_only=True):
    """A store that no process holds, and what a change of it needs.

    Args:
        store: its file.
        trust: the trust folder.
        site: the site model.
        robot: which gate of the folder; None: its only one.
        counter: the store's own, as it was named.
        new: it is made where there is none; else a path with a typing error makes nothing.
    """

    store: Path
    trust: Path
    site: Path
    robot: str | None = None
    counter: Path | None = None
    new: bool = False


@contextmanager
def offline(place: OfflineStore) -> Iterator[Gate]:
    """Yield the gate of a store that no process holds, for one change.

    Raises:
        EnvironmentFault: there is no such store; or as `counter_of`.
        StoreError: the store cannot be used; a gate that holds it is named.
    """
    from authguard_r.operations.offline import offline_gate

    site, rid = load_site(place.site, place.trust), gate_robot(place.trust, place.robot)
    is_there = place.store.is_file() and place.store.stat().st_size > 0
    if not (place.new or is_there):
        raise _unusable(
            "no gate answers and no store is there, so nothing was done; --new makes a store",
            str(place.store),
        )
    with told_of(beside_store(place.store), place.store):
        gate = offline_gate(
            place.trust,
            site,
            rid=rid,
            store=place.store,
            counter=counter_of(place.store, place.counter),
        )
        try:
            yield gate
        finally:
            gate.close()


def counter_of(store: Path, counter: Path | None) -> Counter | None:
    """Return the counter that was named for a store; nothing is written.

    Raises:
        EnvironmentFault: the store was counted and none was named, which says of the person at
            the keyboard more than of the store; or the counter's file is the store's.
    """
    from authguard_r.anchoring.anchor import KIND, KNOWN, known_number
    from authguard_r.anchoring.counter import FileCounter
    from authguard_r.anchoring.evidence import SAID, Discrepancy
    from authguard_r.operations.checkup.apart import Files, apart_advice
    from authguard_r.store.sqlite import read_held

    if counter is None:
        used = store.is_file() and store.stat().st_size > 0  # an empty file is a new store
        if used and known_number(read_held(store, KIND, KNOWN)) is not None:
            why = Discrepancy.COUNTER_NOT_NAMED
            raise _unusable(f"{why}: {SAID[why]}; start the gate, or name --counter", str(store))
        return None
    for found in apart_advice(Files(store=store, counter=counter)):
        raise _unusable(f"{found.message}; {found.mend}", found.place)
    return FileCounter(counter)


def _unusable(message: str, where: str) -> EnvironmentFault:
    return EnvironmentFault(message, reason=Reason.STORE_UNAVAILABLE, where=where)
