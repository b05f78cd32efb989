# SPDX-License-Identifier: Apache-2.0
"""Governance and permissions of DDS Security: written from rights, read for what they allow.

Reading is strict about what it understands and takes the rest for the worst: a pattern that might
match does match, and a rule that denies takes nothing back. What another reader of XML might see
otherwise, a middleware's own, is no document here: a namespace, a section of raw text, a comment
within a value.
Spec page: docs/spec/ros-map.md#keystore
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from collections.abc import Set as AbstractSet
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, tostring

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser, ParseError
from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.ros.rights import RightKind, Rights

_SCHEMAS = "http://www.omg.org/spec/DDS-SECURITY/20170901"
_INSTANCE = "http://www.w3.org/2001/XMLSchema-instance"
_ENCRYPT, _SIGN, _NONE = "ENCRYPT", "SIGN", "NONE"
#: What a governance document has to say of a domain, and of every topic in it.
DOMAIN_RULES = {
    "allow_unauthenticated_participants": "false",
    "enable_join_access_control": "true",
    "discovery_protection_kind": _ENCRYPT,
    "liveliness_protection_kind": _ENCRYPT,
    "rtps_protection_kind": _SIGN,
}
TOPIC_RULES = {
    "enable_discovery_protection": "true",
    "enable_liveliness_protection": "true",
    "enable_read_access_control": "true",
    "enable_write_access_control": "true",
    "metadata_protection_kind": _ENCRYPT,
    "data_protection_kind": _ENCRYPT,
}


_DOMAINS = {"domains": {"id", "id_range"}, "id_range": {"min", "max"}}
_TOPICS = {"topics": {"topic"}, "partitions": {"partition"}}
_RULES = {str(way): set(_TOPICS) for way in RightKind}
#: What may stand in what; in what is not named here, text alone.
PERMISSIONS = {
    "dds": {"permissions"},
    "permissions": {"grant"},
    "grant": {"subject_name", "validity", "allow_rule", "deny_rule", "default"},
    "validity": {"not_before", "not_after"},
    "allow_rule": {"domains", *_RULES},
    "deny_rule": {"domains", *_RULES},
    **_RULES,
    **_TOPICS,
    **_DOMAINS,
}
GOVERNANCE = {
    "dds": {"domain_access_rules"},
    "domain_access_rules": {"domain_rule"},
    "domain_rule": {"domains", "topic_access_rules", *DOMAIN_RULES},
    "topic_access_rules": {"topic_rule"},
    "topic_rule": {"topic_expression", *TOPIC_RULES},
    **_DOMAINS,
}


#: What is said once: of two, one reader might take the first, another the last.
ONCE = {
    *("subject_name", "validity", "not_before", "not_after", "default"),
    *("domains", "min", "max", "topic_expression", "topic_access_rules"),
}


class Opened(Struct, frozen=True, kw_only=True):
    """What a permissions document lets one subject do, at the most.

    Args:
        subject: the subject of the certificate that it is for, as it is written there.
        until: it holds until then.
        publish: topics, or patterns of them, that may be written in the domain.
        subscribe: likewise, read.
        everything: what no rule names is let through.
    """

    subject: str
    until: datetime
    publish: tuple[str, ...]
    subscribe: tuple[str, ...]
    everything: bool

    def may(self, way: RightKind, topic: str) -> bool:
        """True when the document might let the subject do this."""
        patterns = self.publish if way is RightKind.WRITE else self.subscribe
        return self.everything or any(_might_match(pattern, topic) for pattern in patterns)


def governance(domain: int) -> bytes:
    """Return a domain's governance: every participant has a certificate, all is encrypted."""
    root = _document("governance")
    rule = SubElement(SubElement(root, "domain_access_rules"), "domain_rule")
    SubElement(SubElement(rule, "domains"), "id").text = str(domain)
    for name, value in DOMAIN_RULES.items():
        SubElement(rule, name).text = value
    topics = SubElement(SubElement(rule, "topic_access_rules"), "topic_rule")
    SubElement(topics, "topic_expression").text = "*"
    for name, value in TOPIC_RULES.items():
        SubElement(topics, name).text = value
    return _written(root)


def permissions(
    enclave: str, rights: Rights, *, domain: int, since: datetime, until: datetime
) -> bytes:
    """Return what one enclave may do; everything else is denied."""
    root = _document("permissions")
    grant = SubElement(SubElement(root, "permissions"), "grant", name=enclave)
    SubElement(grant, "subject_name").text = f"CN={enclave}"
    validity = SubElement(grant, "validity")
    SubElement(validity, "not_before").text = _time(since)
    SubElement(validity, "not_after").text = _time(until)
    rule = SubElement(grant, "allow_rule")
    SubElement(SubElement(rule, "domains"), "id").text = str(domain)
    for way in RightKind:
        topics = SubElement(SubElement(rule, str(way)), "topics")
        for topic in sorted(rights.of(way)):
            SubElement(topics, "topic").text = topic
    SubElement(grant, "default").text = "DENY"
    return _written(root)


def read_permissions(text: bytes, *, domain: int, where: str) -> tuple[Opened, ...]:
    """Return what each grant of a permissions document lets through in a domain, at the most.

    Raises:
        MalformedError: no such document.
    """
    root = _parsed(text, PERMISSIONS, where=where)
    grants = root.findall("permissions/grant")
    if not grants:
        raise MalformedError("expected permissions of DDS Security", where=where)
    return tuple(_grant(grant, domain=domain, where=where) for grant in grants)


def governance_faults(text: bytes, *, domain: int, where: str) -> Iterator[str]:
    """Yield what a governance document lets through that it must not.

    Raises:
        MalformedError: no such document.
    """
    root = _parsed(text, GOVERNANCE, where=where)
    rules = [rule for rule in root.iter("domain_rule") if _is_in(rule, domain)]
    if not rules:
        raise MalformedError(f"expected rules for domain {domain}", where=where)
    for rule in rules:
        yield from _unlike(rule, DOMAIN_RULES)
        topics = rule.findall("topic_access_rules/topic_rule")
        if not any(_text(topic, "topic_expression") == "*" for topic in topics):
            yield "topic_expression: expected a rule for `*`"
        for topic in topics:
            yield from _unlike(topic, TOPIC_RULES)


def _unlike(rule: Element, wanted: dict[str, str]) -> Iterator[str]:
    for name, value in wanted.items():
        said = [_flag(found.text) for found in rule.findall(name)]
        if said != [value]:
            yield f"{name}: expected {value}, got {', '.join(said) or 'nothing'}"


def _flag(text: str | None) -> str:
    """Return a truth value as XML means it: 1 is true."""
    said = (text or "").strip()
    return {"1": "true", "0": "false"}.get(said, said if said.isupper() else said.lower())


def _grant(grant: Element, *, domain: int, where: str) -> Opened:
    lists: dict[RightKind, list[str]] = {way: [] for way in RightKind}
    for rule in grant.findall("allow_rule"):
        if _is_in(rule, domain):
            for way in RightKind:
                found = rule.findall(f"{way}/topics/topic")
                lists[way] += [(topic.text or "").strip() for topic in found]
    try:
        until = datetime.fromisoformat(_text(grant, "validity/not_after"))
    except ValueError as error:
        raise MalformedError("expected a time", where=f"{where}:not_after") from error
    return Opened(
        subject=_text(grant, "subject_name"),
        until=until if until.tzinfo is not None else until.replace(tzinfo=UTC),
        publish=tuple(lists[RightKind.WRITE]),
        subscribe=tuple(lists[RightKind.READ]),
        everything=_text(grant, "default") != "DENY",
    )


def _is_in(rule: Element, domain: int) -> bool:
    """True of a rule for the domain; a rule with unreadable domains is for all of them."""
    domains = rule.find("domains")
    if domains is None:
        return True
    try:
        if any(_number(found.text) == domain for found in domains.findall("id")):
            return True
        ranges = domains.findall("id_range")
        return any(
            _number(_text(found, "min") or "0") <= domain <= _number(_text(found, "max") or domain)
            for found in ranges
        )
    except ValueError:
        return True


def _number(said: str | int | None) -> int:
    """Return a number that every reader of it reads.

    Raises:
        ValueError: another might read another one, as of `4_2` or of digits that are not ours.
    """
    text = "" if said is None else str(said).strip()
    if not (text.isascii() and text.isdigit()):
        raise ValueError(text)
    return int(text)


def _might_match(pattern: str, topic: str) -> bool:
    """True when an expression of DDS might match; what only its own matcher knows does."""
    return "\\" in pattern or "[" in pattern or fnmatchcase(topic, pattern)


def _text(element: Element, path: str) -> str:
    return (element.findtext(path) or "").strip()


def _parsed(text: bytes, form: Mapping[str, AbstractSet[str]], *, where: str) -> Element:
    """Return a document of a form.

    Raises:
        MalformedError: it is not valid, or might be read as another.
    """
    builder = TreeBuilder(insert_comments=True, insert_pis=True)
    parser = DefusedXMLParser(target=builder, forbid_dtd=True)
    try:
        said = text.decode()  # also when it declares another encoding
        parser.feed(said)
        root: Element = parser.close()
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise MalformedError("expected XML", where=where) from error
    if "<![CDATA[" in said:
        raise MalformedError("expected no section of raw text", where=where)
    if root.tag != "dds":
        raise MalformedError("expected a document of DDS Security", where=where)
    for element in root.iter():
        _require_form(element, form.get(str(element.tag), frozenset()), where=where)
    return root


def _require_form(element: Element, within: AbstractSet[str], *, where: str) -> None:
    """Require that an element holds what may stand in it, and once what is said once.

    Raises:
        MalformedError: it holds something else.
    """
    tags: list[object] = [child.tag for child in element]
    notes = [tag for tag in tags if not isinstance(tag, str)]  # comments, instructions
    named = [str(tag) for tag in tags if isinstance(tag, str)]
    strange = [tag for tag in named if tag not in within or (tag in ONCE and named.count(tag) > 1)]
    if strange or (notes and not within):  # a comment between elements has no effect
        message = f"expected in `{element.tag}` an element of DDS Security, got {named or 'notes'}"
        raise MalformedError(message, where=where)


def _document(kind: str) -> Element:
    schema = f"{_SCHEMAS}/omg_shared_ca_{kind}.xsd"
    return Element("dds", {f"{{{_INSTANCE}}}noNamespaceSchemaLocation": schema})


def _written(root: Element) -> bytes:
    made: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return made


def _time(moment: datetime) -> str:
    return moment.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")
