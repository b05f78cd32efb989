# SPDX-License-Identifier: Apache-2.0
"""Mission versions that were handed in and are not active yet, as the registry holds them.

The first version of a mission is the mission's own standing. The next version of a mission that is
here is held beside that standing, under its own digest. Source: section "Stateful Action
Verification" (the registry R, status `issued`). Spec page: docs/spec/standing.md#handing-in
"""

from __future__ import annotations

from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import StoreError
from authguard_r.core.identifiers import Digest, MissionId
from authguard_r.core.lifecycle import TERMINAL, Status
from authguard_r.core.standing import Standing
from authguard_r.store.transactions import Transaction, read_held

#: Where the store holds a standing beside the mission's own, by digest, and which are issued.
_KIND, _NAMES = "issued", "names"


def registered(act: Transaction, mid: MissionId, digest: Digest) -> Standing | None:
    """Return the registry's entry for one version of a mission.

    Args:
        act: reads the store.
        mid: the mission.
        digest: of the version's signed bytes.

    Returns:
        Its standing in every status; None when this version was never handed in, or when a later
        one took its place.

    Raises:
        StoreError: what is held is no standing.
    """
    known = act.standing(mid)
    if known is not None and known.digest == digest:
        return known
    held = act.get(_KIND, digest)
    beside = read_held(held, Standing, _KIND) if held else None
    return None if beside is None or beside.mid != mid else beside


def issued(act: Transaction) -> tuple[Standing, ...]:
    """Return every mission version whose status is `issued`, in the order of handing in.

    A damaged entry is left out: it authorizes nothing, and `damaged` names it.
    """
    return _read(act)[0]


def damaged(act: Transaction) -> tuple[str, ...]:
    """Return what is wrong with each entry that cannot be read, and its mission."""
    return tuple(str(fault) for fault in _read(act)[1])


def require_readable(act: Transaction) -> None:
    """Require that every entry can be read, before a mission is issued or activated.

    Raises:
        StoreError: the first entry that is damaged.
    """
    for fault in _read(act)[1]:
        raise fault


def _read(act: Transaction) -> tuple[tuple[Standing, ...], tuple[StoreError, ...]]:
    found: list[Standing] = []
    try:
        names = _names(act)
    except StoreError as error:
        return (), (_damage("the list of issued missions", error),)
    faults: list[StoreError] = []
    for mid, digest in names:
        try:
            one = registered(act, mid, digest)
        except StoreError as error:
            faults.append(_damage(f"the entry of the issued mission `{mid}`", error))
            continue
        if one is not None and one.status is Status.ISSUED:
            found.append(one)
    return tuple(found), tuple(faults)


def _damage(what: str, error: StoreError) -> StoreError:
    text = (
        f"{what} is damaged ({error.message}): no mission is issued or activated until the newest "
        "whole store is in place (docs/howto/rollback.md); suspend, revoke and stop still work"
    )
    return StoreError(text, where=error.where, reason=error.reason)


def hold_issued(act: Transaction, standing: Standing) -> None:
    """Hold the standing of a version that was handed in: newly issued, or ended before activation.

    A version that ended keeps its entry, so that its token is never taken in again. Where the log
    is sealed, the gate does not keep its token any longer.
    """
    known = act.standing(standing.mid)
    if known is None or known.digest == standing.digest:
        act.hold(standing)
    else:
        act.put(_KIND, standing.digest, encode_fast(standing))
    if standing.status in TERMINAL and act.seals:
        act.drop_token(standing.digest)
    named, names = (standing.mid, standing.digest), _names(act)
    kept = tuple(name for name in names if name != named)
    if standing.status is Status.ISSUED:
        kept = names if named in names else (*names, named)
    _hold_names(act, kept)


def take_issued(act: Transaction, active: Standing) -> None:
    """Hold the standing of a version that becomes active in the place of its issued entry."""
    act.hold(active)
    if act.get(_KIND, active.digest):
        act.put(_KIND, active.digest, b"")
    _hold_names(act, tuple((one.mid, one.digest) for one in issued(act)))


def _hold_names(act: Transaction, kept: tuple[tuple[MissionId, Digest], ...]) -> None:
    if kept != _names(act):
        act.put(_KIND, _NAMES, encode_fast(kept))


def _names(act: Transaction) -> tuple[tuple[MissionId, Digest], ...]:
    held = act.get(_KIND, _NAMES)
    return read_held(held, tuple[tuple[MissionId, Digest], ...], _KIND) if held else ()
