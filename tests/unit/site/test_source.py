# SPDX-License-Identifier: Apache-2.0
"""Strict YAML: what people write is what is meant, or it is refused with its place."""

from __future__ import annotations

import contextlib
import copy
import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.encoding import MAX_BYTES
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.mission import Row
from authguard_r.core.reasons import Reason
from authguard_r.site.check import faults
from authguard_r.site.model import Parameter, Site
from authguard_r.site.places import adjacent
from authguard_r.site.source import convert, parse_site, read_site, read_text, read_yaml
from authguard_r.site.strict import MAX_DEPTH, MAX_NODES
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from fixtures.time_bounds import at_most

SITE = (scenarios.HOSPITAL / "site.yaml").read_text(encoding="utf-8")


def refused(text: str) -> str:
    with pytest.raises(MalformedError) as caught:
        read_yaml(text, where="site.yaml")
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, "site.yaml")
    return caught.value.message


def yaml(text: str) -> Any:
    return read_yaml(text, where="site.yaml")


# -- words that only look like values --------------------------------------------------------------


def test_a_word_of_the_site_stays_a_word() -> None:
    """`no` is a country, `on` a place, a date a label; none is a truth value or an instant."""
    for word in [
        "no",
        "No",
        "NO",
        "yes",
        "Yes",
        "on",
        "On",
        "off",
        "OFF",
        "y",
        "n",
        "Y",
        "N",
        "True",
        "TRUE",
        "False",
        "FALSE",
        "2026-01-31",
        "2026-01-31T14:30:00Z",
        "2026-01-31 14:30:00",
        "1e3",
        "1E3",
        "infinity",
        "nan",
        "NaN",
        "null-1",
        "~x",
        "0.8 m/s",
        "14:30 h",
        "P1",
    ]:
        with case(word):
            assert yaml(f"a: {word}") == {"a": word}
            assert yaml(f"{word}: a") == {word: "a"}
            assert yaml(f"[{word}]") == [word]


def test_a_value_is_the_one_that_stands_there() -> None:
    for text, value in [
        ("true", True),
        ("false", False),
        ("null", None),
        ("~", None),
        ("", None),
        ("0", 0),
        ("-12", -12),
        ("0.5", 0.5),
        ('"true"', "true"),
        ("'12'", "12"),
        ('"no"', "no"),
    ]:
        with case(text, value):
            found = yaml(f"a: {text}")
            assert found == {"a": value}
            assert type(found["a"]) is type(value)


# -- what is refused -------------------------------------------------------------------------------


def test_a_key_twice_is_refused_at_any_depth() -> None:
    for text in [
        "a: 1\na: 1",
        "a: 1\nb: 2\na: 3",
        "{a: 1, a: 2}",
        "x:\n  - {a: {b: 1, b: 2}}",
        '"a": 1\na: 2',
        "1: a\n1: b",
        "true: a\n1: b",
        "? a\n: 1\n? a\n: 2",
    ]:
        with case(text):
            assert "duplicate key" in refused(text)


def test_the_same_key_in_two_mappings_is_two_keys() -> None:
    assert yaml("[{a: 1}, {a: 2}]") == [{"a": 1}, {"a": 2}]


@pytest.mark.parametrize(
    "text",
    [
        "a: &x [1]\nb: *x",
        "a: &x 1\nb: {c: *x}",
        "&x a: 1\n*x : 2",
        "a: &x [*x]",
        "a: &a [l]\nb: &b [*a, *a]\nc: &c [*b, *b]\nd: [*c, *c]",
    ],
    ids=["alias", "nested", "as a key", "in itself", "a billion laughs"],
)
def test_an_alias_is_refused(text: str) -> None:
    """One place says one thing; and a few lines cannot mean a billion."""
    assert "aliases are not allowed" in refused(text)


@pytest.mark.parametrize("text", ["{<<: {a: 1}}", "a: {b: 1, <<: {b: 2}}", "<<: [{a: 1}]"])
def test_a_merge_is_refused(text: str) -> None:
    refused(text)


@pytest.mark.parametrize(
    "text",
    [
        "!!python/object/apply:os.system ['true']",
        "!!python/name:os.system",
        "!!python/tuple [1]",
        "!!python/object/new:os.system ['true']",
        "a: !mine 1",
        "a: !!unknown 1",
    ],
)
def test_a_tag_of_a_program_is_refused(text: str) -> None:
    refused(text)


def test_broken_yaml_is_refused() -> None:
    for text in [
        "\ta: 1",
        "a:\n\tb: 1",
        "a: [1,\t2]\n\tb: 1",
        "a: 1\n b: 2",
        "a: [1",
        "a: {b: 1",
        "a: 'b",
        'a: "\\x"',
        "a: b: c",
        "a: @b",
        "a: `b`",
        "%YAML 3.0\n---\na: 1",
        "a: 1\n---\nb: 2",
        "a: \0",
        "a: \x07",
        "a: \ud800",
        'a: "\\ud800"',
        '"\\ud83d\\ude00": a',
        "? [a]\n: b",
        "? {a: 1}\n: b",
        "a: =",
        "9" * 5000,
    ]:
        with case(text):
            refused(text)


def test_the_message_says_the_line() -> None:
    assert "line 3" in refused("a: 1\nb: 2\nc: [}\n")


@pytest.mark.parametrize("text", ["[" * 10_000, "- " * 10_000, "{a: " * 10_000])
def test_nesting_that_would_overflow_the_stack_is_refused(text: str) -> None:
    with at_most(1):
        refused(text)


@settings(max_examples=amount(40, 200))
@given(st.text(alphabet="ab01:-,[]{}#'\"&*|>%@\n\t \\.~?", max_size=40))
def test_no_text_without_tags_raises_anything_but_malformed(text: str) -> None:
    with contextlib.suppress(MalformedError):
        yaml(text)


# -- files -----------------------------------------------------------------------------------------


MEGABYTE = 1 << 20


def filled(piece: str) -> str:
    return (piece * (MEGABYTE // len(piece) + 1))[: MEGABYTE - 4]


@pytest.mark.complete
def test_a_megabyte_of_yaml_is_read_or_refused_at_once() -> None:
    for text in [
        filled("- a\n"),
        filled("- - -\n"),
        filled("a: 1\n"),
        filled("'': 1\n"),
        "".join(f"k{number}: 1\n" for number in range(MEGABYTE // 12)),
        f"[{filled('a,')}]",
        f"[{filled('[],')}]",
        f"[{filled('[0, 0], ')}]",
        f"[{filled('{a: b}, ')}]",
        "{" + ",".join(f"k{number}" for number in range(MEGABYTE // 8)) + "}",
        filled("["),
        filled("- "),
        filled("? "),
        filled("word "),
        filled("#\n"),
        filled("\n"),
        filled("--- a\n"),
        f'"{filled("a ")}"',
        f'"{filled(chr(92) + "x41")}"'[:MEGABYTE],
        f"|\n{filled(' a' + chr(10))}",
        filled("&a "),
        filled("!a "),
        filled("<<: {a: 1}\n"),
    ]:
        with case(text), at_most(3), contextlib.suppress(MalformedError):
            read_yaml(text, where="x")


@pytest.mark.complete
def test_more_keys_and_values_than_a_text_may_have_are_refused() -> None:
    most = ["a"] * (MAX_NODES - 1)  # the list is one too
    assert read_yaml(f"[{','.join(most)}]", where="x") == most
    with pytest.raises(MalformedError) as caught:
        read_yaml(f"[{','.join([*most, 'a'])}]", where="x")
    assert (caught.value.reason, caught.value.where) == (Reason.INPUT_TOO_LARGE, "x")


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ("{a: ", "}")])
def test_nesting_is_read_to_its_limit_and_refused_beyond(opening: str, closing: str) -> None:
    """The limit is the text's own: it does not depend on who reads it from how deep a stack."""
    read_yaml(opening * MAX_DEPTH + "1" + closing * MAX_DEPTH, where="x")
    with pytest.raises(MalformedError) as caught:
        read_yaml(opening * (MAX_DEPTH + 1) + "1" + closing * (MAX_DEPTH + 1), where="x")
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, "x")
    assert f"{MAX_DEPTH} levels" in caught.value.message


@pytest.mark.complete
@pytest.mark.parametrize(
    "text",
    [
        lambda of: f"a: [{'1,' * (524_000 // of)}]",
        lambda of: "".join(f"k{number}: 1\n" for number in range(100_000 // of)),
        lambda of: f"{{{','.join(f'k{number}: 1' for number in range(49_000 // of))}}}",
        lambda of: f"[{'1.5e3,' * (99_000 // of)}]",
        lambda of: "[" * (MEGABYTE // of),
        lambda of: "- " * (MEGABYTE // 2 // of),
    ],
    ids=["a megabyte of ones", "keys", "the most keys", "the most numbers", "brackets", "dashes"],
)
def test_a_megabyte_of_yaml_is_read_or_refused_in_little_memory(text: Callable[[int], str]) -> None:
    """Measuring is slow: by default a quarter of each, in a quarter of the memory."""
    of = amount(4, 1)
    tracemalloc.start()
    try:
        with contextlib.suppress(MalformedError):
            read_yaml(text(of), where="x")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak <= 200_000_000 // of


def test_a_text_of_more_than_a_megabyte_is_refused_before_it_is_looked_at() -> None:
    with pytest.raises(MalformedError) as caught:
        read_yaml("a" * (MEGABYTE + 1), where="x")
    assert (caught.value.reason, caught.value.where) == (Reason.INPUT_TOO_LARGE, "x")


def test_a_file_that_cannot_be_read_says_which_and_why(tmp_path: Path) -> None:
    for path in (tmp_path / "nothing.yaml", tmp_path):
        with pytest.raises(EnvironmentFault) as caught:
            read_text(path)
        assert caught.value.reason is Reason.FILE_UNAVAILABLE
        assert caught.value.where == str(path)
        assert str(path) in caught.value.message


@pytest.mark.parametrize("data", [b"\xff", b"a: \xe9", "a: 1".encode("utf-16"), b"a: \xed\xa0\x80"])
def test_a_file_that_is_no_utf_8_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "site.yaml"
    path.write_bytes(data)
    with pytest.raises(MalformedError) as caught:
        read_text(path)
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, str(path))


def test_the_longest_file_is_read_and_one_byte_more_is_not(tmp_path: Path) -> None:
    path = tmp_path / "site.yaml"
    path.write_bytes(b"#" * MAX_BYTES)
    assert len(read_text(path)) == MAX_BYTES
    path.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(MalformedError) as caught:
        read_text(path)
    assert caught.value.where == str(path)


# -- held to a struct ------------------------------------------------------------------------------

SPEED = {"unit": "mm/s", "low": 1, "high": 3000, "rounding": "limit", "required": True}


def test_data_that_fits_is_the_struct() -> None:
    assert convert(SPEED, Parameter, where="x").high == 3000
    assert convert({}, Row, where="x") == Row()


def test_a_value_of_another_type_is_refused_in_its_place() -> None:
    for changes, where in [
        ({"low": 1.0}, "x:low"),
        ({"low": 0.5}, "x:low"),
        ({"low": float("nan")}, "x:low"),
        ({"low": float("inf")}, "x:low"),
        ({"low": True}, "x:low"),
        ({"low": "1"}, "x:low"),
        ({"low": None}, "x:low"),
        ({"low": [1]}, "x:low"),
        ({"low": 2**53}, "x:low"),
        ({"high": -(2**53)}, "x:high"),
        ({"required": 1}, "x:required"),
        ({"required": "true"}, "x:required"),
        ({"required": "no"}, "x:required"),
        ({"rounding": "up"}, "x:rounding"),
        ({"rounding": "Limit"}, "x:rounding"),
        ({"unit": 5}, "x:unit"),
        ({"monitored_by": "Speed"}, "x:monitored_by"),
        ({"monitored_by": "a" * 65}, "x:monitored_by"),
        ({"lower": 1}, "x"),
        ({"Low": 1}, "x"),
    ]:
        with case(changes, where):
            with pytest.raises(MalformedError) as caught:
                convert({**SPEED, **changes}, Parameter, where="x")
            assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, where)


@pytest.mark.parametrize("missing", SPEED)
def test_a_missing_field_is_refused(missing: str) -> None:
    less = {name: value for name, value in SPEED.items() if name != missing}
    with pytest.raises(MalformedError) as caught:
        convert(less, Parameter, where="x")
    assert f"`{missing}`" in caught.value.message


@pytest.mark.parametrize("data", [None, [], "site", 1, True])
def test_data_of_another_shape_is_refused(data: Any) -> None:
    with pytest.raises(MalformedError) as caught:
        convert(data, Site, where="x")
    assert caught.value.where == "x"


# -- a whole site ----------------------------------------------------------------------------------


def site_file(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the shipped site with each text that stands there once replaced."""
    text = SITE
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "site.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_shipped_site_is_read(tmp_path: Path) -> None:
    assert read_site(site_file(tmp_path)) == scenarios.site()


def test_the_order_in_which_a_person_writes_does_not_matter(tmp_path: Path) -> None:
    path = site_file(tmp_path, ("version: 1\n", ""), ("schema: ", "version: 1\nschema: "))
    assert read_site(path) == scenarios.site()


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("version: 1\n", "version: 1.0\n", ":version"),
        ("version: 1\n", "version: one\n", ":version"),
        ("version: 1\n", "version: yes\n", ":version"),
        ("version: 1\n", "version: true\n", ":version"),
        ("version: 1\n", "version: 2026-01-31\n", ":version"),
        ("version: 1\n", "version: -1\n", ":version"),
        ("version: 1\n", "version: 1\nowner: me\n", ""),
        ("version: 1\n", "", ""),
        ("id: hospital-floor-1\n", "id: Hospital Floor 1\n", ":id"),
        ("id: hospital-floor-1\n", "id: 1\n", ":id"),
        ("authguard-r/site/1", "authguard-r/site/2", ":schema"),
        ("approach: [36000, 1500]", "approach: [36000.0, 1500]", ":regions.dock.approach[0]"),
        ("approach: [36000, 1500]", "approach: [36000]", ":regions.dock.approach"),
        ("  dock:\n", "  Dock:\n", ":regions"),
        ("  dock:\n", "  12:\n", ":regions"),
        (
            "        announce: [speaker]",
            "        Announce: [speaker]",
            ":robots.courier-1.profile.tools",
        ),
        ("  dock:\n    {", "  dock: 5\n  quay:\n    {", ":regions.dock"),
        ("[36000, 1500], tags: [staff]", "[36000, 1500], label: [staff]", ":regions.dock"),
        ("objects:\n", "objects: 5\nthings:\n", ""),
        ("approach: [36000, 1500]", "approach: 36000", ":regions.dock.approach"),
        ("names: [Sharps Bin]", "names: [101]", ":objects.sharps-bin.names[0]"),
        ("names: [Sharps Bin]", "names: Sharps Bin", ":objects.sharps-bin.names"),
        ("names: [Sharps Bin]", "names: [~]", ":objects.sharps-bin.names[0]"),
        ("mass_g: 1500", "mass_g: 1.5 kg", ":objects.sharps-bin.mass_g"),
        ("mass_g: 1500", "mass_g: -1", ":objects.sharps-bin.mass_g"),
        ("fields: [object, source]", "fields: [object, sources]", ":vocabulary.pick.fields[1]"),
        ("privacy: 3", "privacy: 4", ":vocabulary.record_video.privacy"),
    ],
)
def test_a_site_file_with_one_fault_is_refused_in_its_place(
    tmp_path: Path, old: str, new: str, where: str
) -> None:
    path = site_file(tmp_path, (old, new))
    with pytest.raises(MalformedError) as caught:
        read_site(path)
    assert caught.value.reason is Reason.MALFORMED
    assert caught.value.where.startswith(f"{path}{where}")


def test_a_site_with_a_fault_of_meaning_is_refused_and_says_how_many_more(tmp_path: Path) -> None:
    one = ("home: station-102", "home: cellar")
    path = site_file(tmp_path, one)
    with pytest.raises(MalformedError) as caught:
        read_site(path)
    assert caught.value.where == f"{path}:objects.sharps-bin.home"
    assert "more" not in caught.value.message
    path = site_file(tmp_path, one, ("tags: [hazardous]", "tags: [z, a]"))
    with pytest.raises(MalformedError) as caught:
        read_site(path)
    assert caught.value.where == f"{path}:regions.plant-room.tags"
    assert "1 more" in caught.value.message


def test_a_duplicate_region_is_refused_before_one_hides_the_other(tmp_path: Path) -> None:
    """The attack: a second `dock` further down, where no reviewer looks."""
    path = site_file(tmp_path, ("doors:\n", "  dock: {map: main}\ndoors:\n"))
    with pytest.raises(MalformedError) as caught:
        read_site(path)
    assert "duplicate key `dock`" in caught.value.message
    assert caught.value.where == str(path)


# -- any data at all -------------------------------------------------------------------------------

PLAIN: Any = msgspec.json.decode(msgspec.json.encode(scenarios.site()))
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=5,
)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every value inside, itself included."""
    more: Any = value.items() if isinstance(value, dict) else ()
    if isinstance(value, list | tuple):
        more = enumerate(value)
    return [path, *(found for key, item in more for found in places(item, (*path, key)))]


PLACES = places(PLAIN)


def with_value(path: tuple[Any, ...], value: Any) -> Any:
    if not path:
        return value
    changed = copy.deepcopy(PLAIN)
    inner = changed
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return changed


@settings(max_examples=amount(60, 300))
@given(st.sampled_from(PLACES), VALUES | st.sampled_from(PLACES).map(lambda path: path[-1:]))
def test_a_site_with_any_value_anywhere_is_judged_or_refused_with_its_file(
    path: tuple[Any, ...], value: Any
) -> None:
    """Nothing else leaves: no traceback, and no fault without a place in ASCII."""
    text = json.dumps(with_value(path, value))
    try:
        site = parse_site(text, where="x")
    except MalformedError as error:
        refusals = [error.where]
    else:
        refusals = ["x"]
        for fault in faults(site):
            assert fault.where
            assert (fault.where + fault.message).isascii()
    assert all(where.partition(":")[0] == "x" for where in refusals)


@settings(max_examples=amount(40, 200))
@given(
    st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=3, max_size=6),
    st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=3, max_size=6),
)
def test_any_two_outlines_are_judged(one: Any, other: Any) -> None:
    """Corners twice, edges of no length, outlines on one line: a fault, never an exception."""
    dock = {**PLAIN["regions"]["dock"], "names": []}
    child = {**dock, "points": other, "within": "a"}
    regions = {"a": {**dock, "points": one}, "b": {**dock, "points": other}, "c": child}
    whole = {**PLAIN, "regions": regions, "doors": [{"between": ["a", "b"], "at": [0, 0]}]}
    site = parse_site(json.dumps(whole), where="x")
    assert faults(site)  # the dock's approach lies far away
    adjacent(site)
