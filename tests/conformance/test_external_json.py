# SPDX-License-Identifier: Apache-2.0
"""The JSON parsing suite (Seriot) through both strict readers: planner text and signed bytes.

`n_` files are not JSON and must be refused; `y_` files are JSON and must be read, apart from those
listed here by name, where we are stricter by design; `i_` files may go either way. Whatever the
file, `MalformedError` is the only exception.
"""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from authguard_r.core.encoding import decode, encode_fast
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.token import Token
from authguard_r.normalize.parse import read_json, read_text

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"
FOLDER = EXTERNAL / "jsontestsuite" / "test_parsing"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]

#: Valid JSON that `read_json` refuses on purpose. Docs: docs/spec/normalize.md#input.
STRICTER = {
    # two readers of one text could see two things
    "y_object_duplicated_key.json": "duplicate key `a`",
    "y_object_duplicated_key_and_value.json": "duplicate key `a`",
    # more than 40 characters, or a decimal exponent beyond 40: no quantity of ours
    "y_number_double_close_to_zero.json": "expected a number of at most 40 characters",
    "y_number.json": "expected a finite number of sensible size",
    "y_number_real_exponent.json": "expected a finite number of sensible size",
    "y_number_real_fraction_exponent.json": "expected a finite number of sensible size",
}
#: The free ones that `read_json` reads; all other free files hold no whole text or number.
READ_FREE = {"i_number_too_big_neg_int.json", "i_number_too_big_pos_int.json"}


def files(kind: str) -> list[Path]:
    return sorted(FOLDER.glob(f"{kind}_*.json"))


def read(path: Path) -> tuple[Any, MalformedError | None]:
    """Return what the file says to a planner's reader, or why it says nothing."""
    try:
        return read_json(read_text(path.read_bytes()), where="input"), None
    except MalformedError as error:
        return None, error


def test_the_suite_is_whole() -> None:
    assert [len(files(kind)) for kind in "nyi"] == [188, 95, 35]


def test_every_file_that_is_no_json_is_refused_as_planner_text() -> None:
    for path in files("n"):
        _, error = read(path)
        assert error is not None, path.name
        assert error.reason is Reason.MALFORMED, path.name
        assert error.where.startswith("input"), path.name


@pytest.mark.parametrize("kind", [object, dict, list, Mission, Token], ids=repr)
def test_every_file_that_is_no_json_is_refused_as_signed_bytes(kind: Any) -> None:
    for path in files("n"):
        with pytest.raises(MalformedError) as caught:
            decode(path.read_bytes(), kind, where="x")
        assert caught.value.where.startswith("x"), path.name


def test_every_json_file_is_read_exactly_apart_from_the_listed_ones() -> None:
    refused = {}
    for path in files("y"):
        value, error = read(path)
        if error is not None:
            refused[path.name] = error.message
        else:
            assert value == json.loads(path.read_bytes(), parse_float=Decimal), path.name
    assert refused == STRICTER


def test_of_the_free_files_only_the_listed_ones_are_read() -> None:
    """Lone surrogates, foreign encodings, byte order marks, huge numbers, 500 levels: refused."""
    assert {path.name for path in files("i") if read(path)[1] is None} == READ_FREE


@pytest.mark.parametrize("kind", [object, dict, list, Mission, Token], ids=repr)
def test_signed_bytes_are_accepted_only_when_they_are_what_we_would_write(kind: Any) -> None:
    """Valid JSON is not enough: one object, one byte string."""
    accepted = 0
    for path in [*files("y"), *files("i")]:
        data = path.read_bytes()
        try:
            value = decode(data, kind)
        except MalformedError:
            continue
        accepted += 1
        assert encode_fast(value) == data, path.name
    assert (accepted > 0) == (kind in {object, dict, list})
