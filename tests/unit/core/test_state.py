# SPDX-License-Identifier: Apache-2.0
"""Attested state carries its own bytes and digest: they are the snapshot's, and nothing else's."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.core.encoding import Tag, digest_of, encode
from authguard_r.core.state import attest
from fixtures import scenarios


@pytest.mark.parametrize("place", ["pharmacy", "dock"])
def test_attested_bytes_and_digest_are_those_of_the_snapshot(place: str) -> None:
    state = scenarios.state(place, "package-p1")
    assert state.data == encode(state.snapshot)
    assert state.digest == digest_of(Tag.STATE, state.snapshot)


def test_another_snapshot_has_another_digest() -> None:
    state = scenarios.state("pharmacy", "package-p1")
    later = msgspec.structs.replace(state.snapshot, seq=state.snapshot.seq + 1)
    again = attest(later, scenarios.facts(), arrived_mono_ms=state.arrived_mono_ms)
    assert again.place == state.place
    assert (again.data, again.digest) != (state.data, state.digest)
    assert again.digest == digest_of(Tag.STATE, later)
