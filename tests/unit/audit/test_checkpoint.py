# SPDX-License-Identifier: Apache-2.0
"""A checkpoint's text is C2SP's, with one line of ours, in exactly one spelling.

Source: C2SP tlog-checkpoint; docs/spec/checkpoint.md#checkpoint
"""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.audit.checkpoint import Checkpoint, origin_of, read_checkpoint, read_size
from authguard_r.audit.note import encode64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId
from fixtures.amount import amount
from fixtures.cases import case

LAW = settings(max_examples=amount(40, 200))
ROOT, CHAIN = bytes(range(32)), bytes(range(32, 64))
HASH = encode64(ROOT)
SAID = Checkpoint(origin="authguard-r/courier-1/audit", size=12, root=ROOT, chain=CHAIN)


def test_the_text_is_origin_size_root_and_chain() -> None:
    assert SAID.text() == (f"authguard-r/courier-1/audit\n12\n{HASH}\nchain {encode64(CHAIN)}\n")
    assert origin_of(RobotId("courier-1")) == SAID.origin


@LAW
@given(
    size=st.integers(0, 2**53 - 1),
    root=st.binary(min_size=32, max_size=32),
    chain=st.none() | st.binary(min_size=32, max_size=32),
)
def test_a_checkpoint_reads_back(size: int, root: bytes, chain: bytes | None) -> None:
    said = Checkpoint(origin="log.example", size=size, root=root, chain=chain)
    assert read_checkpoint(said.text(), where="") == said


def test_others_extension_lines_are_theirs() -> None:
    read = read_checkpoint(f"o\n0\n{HASH}\nour line\nchain {HASH}\nchains\n", where="")
    assert read == Checkpoint(origin="o", size=0, root=ROOT, chain=ROOT)


def test_what_is_no_checkpoint_is_refused() -> None:
    for text in [
        "",
        "o\n",
        "o\n1\n",
        f"o\n1\n{HASH}",
        f"\n1\n{HASH}\n",
        f"o\n\n{HASH}\n",
        f"o\n1\n{HASH}\n\n",
        f"o\n1\n{HASH}\n\nmore\n",
        "o\n1\nAAAA\n",
        "o\n1\nnot base64\n",
        f"o\n01\n{HASH}\n",
        f"o\n-1\n{HASH}\n",
        f"o\n+1\n{HASH}\n",
        f"o\n1 \n{HASH}\n",
        f"o\n\u0661\n{HASH}\n",
        f"o\n{2**53}\n{HASH}\n",
        f"o\n{'1' * 17}\n{HASH}\n",
        f"o\n1\n{HASH}\nchain {HASH}\nchain {HASH}\n",
        f"o\n1\n{HASH}\nchain AAAA\n",
        f"o\n1\n{HASH}\nchain \n",
    ]:
        with case(text):
            with pytest.raises(MalformedError) as caught:
                read_checkpoint(text, where="note")
            assert caught.value.where == "note"


@pytest.mark.parametrize("size", [0, 1, 10, 2**53 - 1])
def test_a_size_has_one_spelling(size: int) -> None:
    assert read_size(str(size), where="") == size
    with pytest.raises(MalformedError):
        read_size(f"0{size}", where="")
