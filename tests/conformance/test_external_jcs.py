# SPDX-License-Identifier: Apache-2.0
"""RFC 8785 against its author's own documents: the canonical encoder, byte for byte."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import rfc8785

from authguard_r.core.encoding import decode, encode, encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]

DOCUMENTS = ["arrays", "french", "structures", "unicode", "values", "weird"]
#: Signed data holds no null and no float, so these are RFC 8785 but never signed.
UNSIGNED = {"arrays", "structures", "values"}


def source(name: str) -> Any:
    return json.loads((EXTERNAL / "jcs" / "input" / f"{name}.json").read_text(encoding="utf-8"))


def expected(name: str) -> bytes:
    return bytes.fromhex((EXTERNAL / "jcs" / "outhex" / f"{name}.txt").read_text(encoding="ascii"))


def test_the_documents_are_the_ones_that_this_test_names() -> None:
    found = sorted(path.stem for path in (EXTERNAL / "jcs" / "input").iterdir())
    assert found == DOCUMENTS


@pytest.mark.parametrize("name", DOCUMENTS)
def test_the_library_that_signs_writes_the_expected_bytes(name: str) -> None:
    assert rfc8785.dumps(source(name)) == expected(name)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_our_encoder_writes_the_same_or_refuses_what_signed_data_cannot_hold(name: str) -> None:
    if name in UNSIGNED:
        with pytest.raises(TypeError):
            encode(source(name))
    else:
        assert encode(source(name)) == expected(name)


@pytest.mark.parametrize("name", ["french", "unicode"])
def test_the_fast_encoder_and_the_decoder_agree_with_it(name: str) -> None:
    assert encode_fast(source(name)) == expected(name)
    assert decode(expected(name), dict) == source(name)


@pytest.mark.parametrize("name", DOCUMENTS)
def test_a_document_as_it_was_written_is_not_canonical(name: str) -> None:
    data = (EXTERNAL / "jcs" / "input" / f"{name}.json").read_bytes()
    assert data != expected(name)
    with pytest.raises(MalformedError) as caught:
        decode(data, object, where="x")
    assert (caught.value.reason, caught.value.where) == (Reason.NOT_CANONICAL, "x")
