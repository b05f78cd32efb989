# SPDX-License-Identifier: Apache-2.0
"""A binding is sound for one site, or the first fault is named with its place."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import Tag, decode, digest, encode
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.binding import (
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    binding_digest,
    load_binding,
    require_sound,
)
from authguard_r.site.source import read_text, read_yaml
from fixtures import scenarios
from fixtures.cases import case

Plain = dict[str, Any]


def plain() -> Plain:
    data = read_yaml(read_text(scenarios.HOSPITAL / "binding.yaml"), where="binding")
    assert isinstance(data, dict)
    return copy.deepcopy(data)


def load(data: Any) -> Binding:
    return load_binding(data, site=scenarios.site(), where="binding")


def changed(tool: str, **fields: Any) -> Plain:
    data = plain()
    data["tools"][tool].update(fields)
    return data


def argument(tool: str, name: str, **fields: Any) -> Plain:
    data = plain()
    data["tools"][tool]["arguments"].setdefault(name, {}).update(fields)
    return data


def without(tool: str, name: str) -> Plain:
    data = plain()
    del data["tools"][tool]["arguments"][name]
    return data


def test_the_shipped_binding_is_sound() -> None:
    assert load(plain()) == scenarios.binding()
    require_sound(scenarios.binding(), scenarios.site())


#: What its types cannot say: `SCHEMA_INVALID` at the place.
UNSOUND: dict[str, tuple[Callable[[], Plain], str]] = {
    "a type that the site does not have": (
        lambda: changed("scan", type="sing"),
        "tools.scan.type",
    ),
    "mapped to nothing": (
        lambda: argument("pick_up", "object", to=""),
        "tools.pick_up.arguments.object.to",
    ),
    "noted with a target": (
        lambda: argument("pick_up", "reason", to="object"),
        "tools.pick_up.arguments.reason.to",
    ),
    "refused with a target": (
        lambda: argument("navigate_to", "behavior_tree", to="route"),
        "tools.navigate_to.arguments.behavior_tree.to",
    ),
    "mapped to a field that the type does not have": (
        lambda: argument("wait", "where", use="mapped", to="destination"),
        "tools.wait.destination",
    ),
    "mapped to a parameter that the type does not have": (
        lambda: argument("wait", "speed", use="mapped", to="params.speed_mm_s"),
        "tools.wait.params.speed_mm_s",
    ),
    "mapped to provenance": (
        lambda: argument("wait", "label", use="mapped", to="provenance"),
        "tools.wait.provenance",
    ),
    "mapped to the tool": (
        lambda: argument("wait", "with", use="mapped", to="tool"),
        "tools.wait.tool",
    ),
    "fixed field that the type does not have": (
        lambda: changed("scan", fixed={"destination": "dock"}),
        "tools.scan.destination",
    ),
    "attested field that the type does not have": (
        lambda: changed("scan", attested=["source"]),
        "tools.scan.source",
    ),
    "one field from two arguments": (
        lambda: argument("put_down", "to", use="mapped", to="destination"),
        "tools.put_down.destination",
    ),
    "one field fixed and mapped": (
        lambda: changed("pick_up", fixed={"object": "package-p1"}),
        "tools.pick_up.object",
    ),
    "one field fixed and attested": (
        lambda: changed("pick_up", fixed={"source": "pharmacy"}),
        "tools.pick_up.source",
    ),
    "one field attested and mapped": (
        lambda: argument("pick_up", "from", use="mapped", to="source"),
        "tools.pick_up.source",
    ),
    "a factor that is no number": (
        lambda: argument("wait", "seconds", per_unit="many"),
        "tools.wait.arguments.seconds.per_unit",
    ),
    "a factor of nothing": (
        lambda: argument("wait", "seconds", per_unit="0"),
        "tools.wait.arguments.seconds.per_unit",
    ),
    "a factor that divides by nothing": (
        lambda: argument("wait", "seconds", per_unit="1/0"),
        "tools.wait.arguments.seconds.per_unit",
    ),
    "a factor that turns a quantity round": (
        lambda: argument("wait", "seconds", per_unit="-1000"),
        "tools.wait.arguments.seconds.per_unit",
    ),
    "a factor too long to read": (
        lambda: argument("wait", "seconds", per_unit="1" * 21),
        "tools.wait.arguments.seconds.per_unit",
    ),
    "a default below the type's range": (
        lambda: argument("wait", "seconds", optional=True, default=0),
        "tools.wait.arguments.seconds.default",
    ),
    "a default above the type's range": (
        lambda: argument("wait", "seconds", optional=True, default=3_600_001),
        "tools.wait.arguments.seconds.default",
    ),
    "a default for a place": (
        lambda: argument("pick_up", "object", optional=True, default=1),
        "tools.pick_up.arguments.object.default",
    ),
    "a fixed number above the type's range": (
        lambda: changed("take_photo", fixed={"params.max_bytes": 100_000_001}),
        "tools.take_photo.fixed.params.max_bytes",
    ),
    "a fixed number that is text": (
        lambda: changed("take_photo", fixed={"params.max_bytes": "all"}),
        "tools.take_photo.fixed.params.max_bytes",
    ),
    "a fixed place that the site does not have": (
        lambda: changed("pick_up", attested=[], fixed={"source": "cellar"}),
        "tools.pick_up.fixed.source",
    ),
    "a fixed place that is an object": (
        lambda: changed("pick_up", attested=[], fixed={"source": "package-p1"}),
        "tools.pick_up.fixed.source",
    ),
    "a field from nowhere": (lambda: changed("pick_up", attested=[]), "tools.pick_up.arguments"),
    "an object from nowhere": (lambda: without("pick_up", "object"), "tools.pick_up.arguments"),
    "a required parameter from nowhere": (
        lambda: changed("take_photo", fixed={}),
        "tools.take_photo.arguments",
    ),
}


def test_a_binding_with_one_fault_is_refused_in_its_place() -> None:
    for name, (make, where) in UNSOUND.items():
        with case(name):
            with pytest.raises(MalformedError) as caught:
                load(make())
            assert (caught.value.reason, caught.value.where) == (Reason.SCHEMA_INVALID, where)


#: As near to a fault as a sound binding can be.
SOUND: dict[str, Callable[[], Plain]] = {
    "a route from nowhere": lambda: without("navigate_to", "via"),
    "a parameter with a default": lambda: argument("wait", "seconds", optional=True, default=1000),
    "a field fixed instead of attested": lambda: changed(
        "pick_up", attested=[], fixed={"source": "pharmacy"}
    ),
    "a field mapped instead of attested": lambda: {
        **plain(),
        "tools": {
            "take": {
                "type": "take_photo",
                "tool": "camera",
                "fixed": {"params.max_bytes": 1},
                "arguments": {"from": {"use": "mapped", "to": "source"}},
            }
        },
    },
    "a default at the type's least": lambda: argument("wait", "seconds", optional=True, default=1),
    "a default at the type's most": lambda: argument(
        "wait", "seconds", optional=True, default=3_600_000
    ),
    "a fixed number at the type's most": lambda: changed(
        "take_photo", fixed={"params.max_bytes": 100_000_000}
    ),
    "a factor that is a share": lambda: argument("wait", "seconds", per_unit="1/3"),
    "a factor that is a decimal": lambda: argument("wait", "seconds", per_unit="0.001"),
    "a factor of the greatest length": lambda: argument("wait", "seconds", per_unit="1" * 20),
    "one more noted field": lambda: argument("wait", "why", use="noted"),
    "a state-writing tool without its fields": lambda: changed("relocalize", arguments={}),
    "no tools at all": lambda: {**plain(), "tools": {}},
}


def test_a_binding_that_just_keeps_the_rule_is_sound() -> None:
    for name, make in SOUND.items():
        with case(name):
            assert isinstance(load(make()), Binding)


@pytest.mark.parametrize("name", ["g\u00f6", "scan\u200b", "\u0455can"])
def test_a_tool_or_an_argument_outside_ascii_is_refused(name: str) -> None:
    data = plain()
    data["tools"][name] = data["tools"]["scan"]
    for one in (data, argument("wait", name, use="noted")):
        with pytest.raises(MalformedError) as caught:
            load(one)
        assert caught.value.where.isascii()


def test_a_binding_for_another_site_is_refused() -> None:
    with pytest.raises(MalformedError) as caught:
        load({**plain(), "site": "hospital-floor-2"})
    assert caught.value.where == "site"
    assert "hospital-floor-1" in caught.value.message


#: What its types say: `MALFORMED` at the place.
def test_data_that_is_no_binding_is_malformed_in_its_place() -> None:
    for data, where in [
        (lambda: None, "binding"),
        (list, "binding"),
        (lambda: {**plain(), "schema": "authguard-r/binding/2"}, "binding:schema"),
        (lambda: {**plain(), "extra": 1}, "binding"),
        (lambda: {**plain(), "id": "Courier Tools"}, "binding:id"),
        (lambda: {k: v for k, v in plain().items() if k != "tools"}, "binding"),
        (lambda: changed("scan", kind="scan"), "binding:tools.scan"),
        (lambda: changed("scan", attested=["destination"]), "binding:tools.scan.attested[0]"),
        (lambda: changed("scan", attested="source"), "binding:tools.scan.attested"),
        (lambda: changed("scan", fixed={"x": 1.5}), "binding:tools.scan.fixed.x"),
        (lambda: changed("scan", fixed={"x": True}), "binding:tools.scan.fixed.x"),
        (lambda: changed("scan", fixed={"x": "Dock"}), "binding:tools.scan.fixed.x"),
        (
            lambda: argument("wait", "seconds", use="ignored"),
            "binding:tools.wait.arguments.seconds.use",
        ),
        (
            lambda: argument("wait", "seconds", optional=1),
            "binding:tools.wait.arguments.seconds.optional",
        ),
        (
            lambda: argument("wait", "seconds", default=0.5),
            "binding:tools.wait.arguments.seconds.default",
        ),
        (
            lambda: argument("wait", "seconds", per_unit=1000),
            "binding:tools.wait.arguments.seconds.per_unit",
        ),
        (lambda: argument("wait", "seconds", unit="s"), "binding:tools.wait.arguments.seconds"),
        (lambda: argument("wait", "why", to=""), "binding:tools.wait.arguments.why"),
    ]:
        with case(data, where):
            with pytest.raises(MalformedError) as caught:
                load(data())
            assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, where)


def test_a_binding_s_digest_is_that_of_its_canonical_bytes_and_changes_with_it() -> None:
    shipped = scenarios.binding()
    assert binding_digest(shipped) == digest(Tag.BINDING, encode(shipped))
    assert decode(encode(shipped), Binding) == shipped
    other = load(argument("navigate_to", "speed", default=501))
    assert binding_digest(other) != binding_digest(shipped)


def test_every_default_of_an_argument_is_the_narrow_one() -> None:
    assert Argument(use=ArgumentUse.REFUSED) == Argument(
        use=ArgumentUse.REFUSED, to="", per_unit="1", optional=False, default=None
    )
    bare = ToolBinding(type="wait", tool="base")
    assert (bare.arguments, bare.fixed, bare.attested) == ({}, {}, ())
    with pytest.raises(TypeError):
        Argument()  # type: ignore[call-arg]


def test_a_binding_cannot_be_changed_once_it_is_sound() -> None:
    with pytest.raises(AttributeError):
        scenarios.binding().site = "elsewhere"  # type: ignore[misc]
    assert msgspec.structs.replace(scenarios.binding(), id="x").site == scenarios.binding().site
