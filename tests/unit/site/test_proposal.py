# SPDX-License-Identifier: Apache-2.0
"""What an import writes: numbers as they were written, ids that can be ids, a file that fits."""

from __future__ import annotations

from decimal import Decimal

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.authoring.site.proposal import (
    SiteProposal,
    exact,
    identifier,
    millimeters,
    to_yaml,
)
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import is_identifier
from authguard_r.site.source import parse_site
from fixtures import scenarios
from fixtures.cases import case

replace = msgspec.structs.replace


def test_a_length_is_the_decimal_that_was_written() -> None:
    for meters, found in [
        (1, 1000),
        (-3.5, -3500),
        (0.1, 100),
        (2.3, 2300),
        (0.0005, 0),
        (0.0015, 2),
        (-0.0005, 0),
        (1e-9, 0),
        (Decimal("1.2345"), 1234),
    ]:
        with case(meters, found):
            assert millimeters(meters, where="x") == found


def test_what_is_no_length_on_a_site_is_refused() -> None:
    for value in [
        True,
        None,
        "1",
        [1],
        float("nan"),
        float("inf"),
        10**12,
        -1e300,
        Decimal("sNaN"),
    ]:
        with case(value):
            with pytest.raises(MalformedError) as caught:
                exact(value, where="x")
            assert caught.value.where == "x"


@given(st.text(max_size=70))
def test_an_id_is_made_or_refused(name: str) -> None:
    try:
        made = identifier(name, where="x")
    except MalformedError as error:
        made = "refused" if error.where == "x" else ""
    assert is_identifier(made)


@pytest.mark.parametrize(
    ("name", "found"),
    [("desk_1", "desk_1"), ("Nurse Station 101", "nurse-station-101"), ("/cmd_vel/", "cmd_vel")],
)
def test_an_id_keeps_what_an_id_can_hold(name: str, found: str) -> None:
    assert identifier(name, where="x") == found


@given(st.lists(st.text(min_size=1, max_size=8), max_size=4, unique=True))
def test_a_file_with_any_names_reads_as_the_site_or_is_refused(names: list[str]) -> None:
    """Quotes, colons, hashes, `yes` and `null` are names like others."""
    region = replace(scenarios.site().regions["dock"], names=tuple(names))
    site = replace(scenarios.site(), regions={"r": region}, doors=(), objects={}, robots={})
    try:
        text = to_yaml(SiteProposal(site=site, missing=()), where="x")
    except MalformedError:
        return
    assert parse_site(text, where="x") == site


@pytest.mark.parametrize("name", ["0\x850", "a\nb", "a\u2028b", "a\x00b", "\x1b[2J"])
def test_a_name_that_a_reader_of_yaml_would_mend_is_refused(name: str) -> None:
    region = replace(scenarios.site().regions["dock"], names=(name,))
    site = replace(scenarios.site(), regions={"r": region}, doors=(), objects={}, robots={})
    with pytest.raises(MalformedError, match="printable"):
        to_yaml(SiteProposal(site=site, missing=()), where="x")


def test_a_name_that_yaml_would_read_as_something_else_stays_that_name() -> None:
    for name in ["yes", "null", "1", "0x10", "a: b", "# a", "'", '"', "-", "é", "~"]:
        with case(name):
            region = replace(scenarios.site().regions["dock"], names=(name,))
            site = replace(scenarios.site(), regions={"1": region}, doors=(), objects={}, robots={})
            assert (
                parse_site(to_yaml(SiteProposal(site=site, missing=("x",)), where="x"), where="x")
                == site
            )


def test_the_hospital_written_and_read_again_is_the_hospital() -> None:
    text = to_yaml(SiteProposal(site=scenarios.site(), missing=()), where="x")
    assert parse_site(text, where="x") == scenarios.site()


def test_a_site_longer_than_a_site_may_be_is_not_written() -> None:
    with pytest.raises(MalformedError) as caught:
        to_yaml(SiteProposal(site=scenarios.site(), missing=("a" * (1 << 20),)), where="x")
    assert caught.value.where == "x"
