# SPDX-License-Identifier: Apache-2.0
"""What is appended is spelled by hand for speed; these laws hold it to the structs that define it.

The oracle links the same record to the same value.

Source: `eq:log`; docs/spec/audit-record.md
"""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

import authguard_reference as oracle
from authguard_r.audit.record import (
    Commitment,
    Entry,
    Sealed,
    append,
    commit,
    evidence,
    read_record,
    read_sealed,
)
from authguard_r.core.chain import GENESIS, link
from authguard_r.core.encoding import Tag, b64, digest_of, encode, encode_fast

LAW = settings(max_examples=200)
names = st.from_regex(r"\A[a-z][a-z0-9_]{0,15}\Z")
texts = st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=20)
leaves = st.booleans() | st.integers(-(2**53) + 1, 2**53 - 1) | texts
values = st.recursive(
    leaves, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=3)
)


class Log:
    """A turn that keeps what was appended (`core.ports.Turn`)."""

    def __init__(self) -> None:
        self.rows: list[tuple[bytes, bytes, bytes]] = []

    def get(self, kind: str, key: str) -> bytes | None:
        return None

    def put(self, kind: str, key: str, value: bytes) -> None:
        raise AssertionError("an append holds nothing")

    def head(self) -> tuple[int, bytes]:
        return len(self.rows), self.rows[-1][2] if self.rows else GENESIS

    def append(self, record: bytes, sealed: bytes, link: bytes) -> int:
        self.rows.append((record, sealed, link))
        return len(self.rows) - 1


@LAW
@given(
    sealed=st.dictionaries(names, values, max_size=7),
    opened=st.dictionaries(names, values, max_size=3),
    salts=st.binary(min_size=16 * 7, max_size=16 * 7),
)
def test_appended_bytes_are_the_canonical_encoding_of_the_structs(
    sealed: dict[str, Any], opened: dict[str, Any], salts: bytes
) -> None:
    log = Log()
    entry = Entry(kind="decision", time_ms=7, decision="accept", open=opened, sealed=sealed)
    assert append(log, entry, salts=salts) == 0
    record, beside, linked = log.rows[0]

    expected = {
        name: Sealed(salt=b64(salts[16 * n : 16 * n + 16]), value=sealed[name])
        for n, name in enumerate(sorted(sealed))
    }
    assert beside == encode_fast(expected) == encode(expected)
    assert read_sealed(beside, where="") == expected
    read = read_record(record, where="")
    assert read.committed == {name: commit(name, item) for name, item in expected.items()}
    assert read.link.evidence == evidence("decision", opened, read.committed)
    assert linked == link(read.link)
    assert linked.hex() == oracle.link(msgspec.to_builtins(read.link))


@LAW
@given(names, values, st.binary(min_size=16, max_size=16))
def test_a_commitment_is_the_digest_of_name_salt_and_value(
    name: str, value: Any, salt: bytes
) -> None:
    log = Log()
    entry = Entry(kind="outcome", time_ms=1, decision="failed", open={}, sealed={name: value})
    append(log, entry, salts=salt)
    spelled = Commitment(name=name, salt=b64(salt), value=value)
    committed = read_record(log.rows[0][0], where="").committed
    assert committed == {name: digest_of(Tag.COMMITMENT, spelled)}
