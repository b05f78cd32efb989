# SPDX-License-Identifier: Apache-2.0
"""Sealed fields: what of a record only some roles may read, and what may be destroyed later.

The fields of a record fall into classes. Values of sealed classes lie in envelopes beside the
record, one for each set of classes, encrypted with AES-256-GCM under the keys of all classes of the
set. A reader needs every key of the set; once one of them is destroyed, the envelope cannot be
opened. The record commits to every field by itself, with a salt that lies in the box, and to the
box: who has no key verifies the chain as ever, who has one holds each value to its commitment.

A sealed action would be guessed from its digest, so a record with boxes links a salted one.
Spec page: docs/spec/sealed-fields.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import msgspec
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.audit.record import (
    BOX,
    NONE,
    Attachment,
    Entry,
    LogRow,
    Record,
    Sealed,
    commit,
    joined,
    read_record,
    read_sealed,
    spelled,
    write,
)
from authguard_r.core.encoding import b64, encode_fast, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Base64Url, Count, RobotId
from authguard_r.core.mission import DataClass
from authguard_r.core.ports import Turn

Classes = tuple[DataClass, ...]
_E, _O, _P, _R = DataClass.EVIDENCE, DataClass.OBJECT, DataClass.PARAMETER, DataClass.REGION
_WHO = DataClass.PERSON
#: The class for an action, its place and the reason.
_TOLD: Classes = (_E, _O, _P, _R)
#: The digests that the record of a covered decision does not link.
LINKS = "links"
#: An action in parts.
ACT, OBJECT, PARAMS, REGIONS = "action.act", "action.object", "action.params", "action.regions"
_PARTS: dict[str, tuple[str, ...]] = {
    ACT: ("type", "tool", "provenance", "meta"),
    OBJECT: ("object",),
    PARAMS: ("params",),
    REGIONS: ("source", "destination", "route"),
}
_SOMEBODY = ("approvers", "by", "caller", "issuer", "members", "scheduler", "signer")
#: Open fields with words that people chose, and the classes that these reveal; sealed under their
#: names.
SPOKEN: dict[str, Classes] = {
    **dict.fromkeys(_SOMEBODY, (_WHO,)),
    "grant": _TOLD,
}
#: A stream's running digest is guessed like any digest of few numbers.
_STREAM: dict[str, Classes] = {"digest": (_P,)}
#: The classes that a field reveals. A field that is not named here reveals all of them.
CLASSES: Final[dict[str, Classes]] = {
    ACT: (_E,),
    OBJECT: (_O,),
    PARAMS: (_P,),
    REGIONS: (_R,),
    **dict.fromkeys(("capability", "influences", LINKS), _TOLD),
    **dict.fromkeys(("findings", "standing", "where", "message", "plan", "entries"), _TOLD),
    **SPOKEN,
    **_STREAM,
    "command": (_WHO,),
    "dialect": (_E,),
    "extremes": (_P,),
    "state": (_E, _O, _R),  # where the robot is, and what it holds
    "why": (_E, _WHO),
    # of no mission: when it was, where the robot lives, what is published, the keys themselves
    **dict.fromkeys(("now", "site", "safety", "policy", "list"), ()),
}
#: The kind of the record that holds the wrapped keys of a mission's envelopes.
SEALING = "sealing"
_BOX_INFO = b"authguard-r/box/1\0"
_KEY, _NONCE, _SALT = 32, 12, 16


class Cover(Struct, frozen=True, kw_only=True):
    """The keys that a mission's records are sealed with, for as long as this gate runs.

    Args:
        robot: whose log it is.
        keys: number of the record that holds the wrapped keys.
        classes: 32 secret bytes of each class that is sealed; other classes are not encrypted.
        ciphers: what was made of them; they are forgotten together.
    """

    robot: RobotId
    keys: int
    classes: dict[DataClass, bytes]
    ciphers: dict[Classes, AESGCM] = {}


class SealedEnvelope(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sealed values that are sealed together.

    Args:
        keys: number of the record with their keys.
        nonce: 12 bytes, fresh for each box.
        text: the values in canonical form, as they would lie beside the record, and the tag.
    """

    keys: Count
    nonce: Base64Url
    text: Base64Url


class _Where(Struct, frozen=True, kw_only=True):
    """What a box is bound to: it opens nowhere else."""

    robot: RobotId
    mid: str
    seq: int
    classes: Classes


#: Returns the key of a class by the number of its record; None when it is not available.
KeyOf = Callable[[int, DataClass], bytes | None]


def classes_of(name: str) -> Classes:
    """Return the classes of data in a sealed value; an unlisted value counts as every class."""
    return CLASSES.get(name, tuple(DataClass))


def append_covered(turn: Turn, entry: Entry, cover: Cover, *, salts: Callable[[int], bytes]) -> int:
    """Append the entry to the log in this turn, sealed; return its number.

    Args:
        turn: the writer's turn.
        entry: what to record.
        cover: the keys.
        salts: returns that many fresh random bytes.
    """
    seq = turn.head()[0]
    beside = Attachment()
    boxes: dict[Classes, dict[str, bytes]] = {}
    entry = _without_words(entry, cover)
    for name, value in sorted(_fields(entry, cover).items()):
        item = spelled(value, salts(_SALT))
        classes = tuple(one for one in classes_of(name) if one in cover.classes)
        if classes:
            beside.commit(name, item)
            boxes.setdefault(classes, {})[name] = item
        else:
            beside.add(name, item)
    for classes, items in boxes.items():
        place = _Where(robot=cover.robot, mid=entry.mid, seq=seq, classes=classes)
        box = _sealed(items, cover, place, salts)
        beside.add(BOX + "+".join(classes), spelled(box, salts(_SALT)))
    linked = beside.committed.get(LINKS)
    if linked is not None:
        action, state = (linked if one != NONE else NONE for one in (entry.action, entry.state))
        entry = replace(entry, action=action, state=state)
    return write(turn, entry, beside)


def opened(row: LogRow, *, robot: RobotId, key_of: KeyOf) -> LogRow:
    """Return the row as it would be had nothing of it been sealed, as far as the keys go.

    A box that stays closed lies beside the record as before, one that opened is gone from there
    and from what the record commits to; an action of which a part is closed falls into its parts.
    The chain does not bind this row any more: what is verified is the one that was given.

    Args:
        row: as it is stored; untrusted.
        robot: whose log it is.
        key_of: the reader's keys.

    Raises:
        MalformedError: no record, an invalid envelope, or one that the record does not commit to.
    """
    if BOX.encode() not in row.sealed:
        return row
    where = f"record {row.seq}"
    record, sealed = read_record(row.record, where=where), read_sealed(row.sealed, where=where)
    values, committed = dict(sealed), dict(record.committed)
    for name in [name for name in sealed if name.startswith(BOX)]:
        found = _opened(name, sealed[name], record, robot, key_of)
        if found is not None:
            del values[name]
            committed.pop(name, None)
            values |= found
    record = replace(record, committed=committed)
    return replace(
        row,
        record=encode_fast(_told(record, values)),
        sealed=encode_fast(_whole(values)),
    )


def act_of(values: dict[str, Any]) -> dict[str, Any] | None:
    """Return an action, or what is known of one of which parts are closed; None without any.

    Args:
        values: opened values by name.
    """
    if "action" in values:
        whole = values["action"]
        return whole if isinstance(whole, dict) else None
    parts = [values[name] for name in _PARTS if isinstance(values.get(name), dict)]
    return {field: value for part in parts for field, value in part.items()} if parts else None


def _opened(
    name: str, sealed: Sealed, record: Record, robot: RobotId, key_of: KeyOf
) -> dict[str, Sealed] | None:
    """Return what lies in a box, None without all of its keys."""
    where = f"record {record.link.seq}: {name}"
    try:
        box = msgspec.convert(sealed.value, SealedEnvelope)
        classes = tuple(map(DataClass, name.removeprefix(BOX).split("+")))
    except (msgspec.ValidationError, ValueError) as error:
        raise MalformedError(f"expected a box: {error}", where=where) from error
    keys = [key_of(box.keys, one) for one in classes]
    if None in keys:
        return None
    link = record.link
    place = _Where(robot=robot, mid=link.mid, seq=link.seq, classes=classes)
    try:
        text = _cipher(key for key in keys if key is not None).decrypt(
            unb64(box.nonce, where=where), unb64(box.text, where=where), encode_fast(place)
        )
    except (InvalidTag, ValueError) as error:
        raise MalformedError("the box was not sealed for this place", where=where) from error
    found = read_sealed(text, where=where)
    for field, one in found.items():
        if record.committed.get(field) != commit(field, one):
            raise MalformedError(f"the value `{field}` does not match its commitment", where=where)
    return found


def _told(record: Record, values: dict[str, Sealed]) -> Record:
    """Return the record with the words and the digests that it would show."""
    spoken = {name: values[name].value for name in (*SPOKEN, *_STREAM) if name in values}
    link = record.link
    if LINKS in values:
        try:
            links = msgspec.convert(values[LINKS].value, _Links)
        except msgspec.ValidationError as error:
            raise MalformedError(str(error), where=f"record {link.seq}: {LINKS}") from error
        salted = {
            "action": NONE if links.action == NONE else record.committed.get(LINKS),
            "state": NONE if links.state == NONE else record.committed.get(LINKS),
        }
        if (link.action, link.state) != (salted["action"], salted["state"]):
            text = "expected the link to be the commitment to both digests"
            raise MalformedError(text, where=f"record {link.seq}: {LINKS}")
        link = replace(link, action=links.action, state=links.state)
    return replace(record, link=link, open={**record.open, **spoken})


class _Links(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    action: str
    state: str


def _whole(values: dict[str, Sealed]) -> dict[str, Sealed]:
    """Return the values as they were before; a whole action has the salt of its first part."""
    rest = {n: one for n, one in values.items() if n not in {*SPOKEN, *_STREAM, LINKS}}
    parts = {name: rest.pop(name) for name in _PARTS if name in rest}
    if parts.keys() != _PARTS.keys():
        return rest | parts
    action = act_of({name: one.value for name, one in parts.items()})
    return rest | {"action": Sealed(salt=parts[ACT].salt, value=action)}


def _without_words(entry: Entry, cover: Cover) -> Entry:
    """Return the entry with the open fields that people's words are in among the sealed ones."""
    words = {**SPOKEN, **_STREAM} if entry.kind == "stream" else SPOKEN
    spoken = {
        name: entry.open[name]
        for name, classes in words.items()
        if name in entry.open and not cover.classes.keys().isdisjoint(classes)
    }
    rest = {name: value for name, value in entry.open.items() if name not in spoken}
    return replace(entry, open=rest, sealed={**entry.sealed, **spoken})


def _fields(entry: Entry, cover: Cover) -> dict[str, Any]:
    """Return what is sealed, field by field, with the digests that cannot be linked any more."""
    fields = dict(entry.sealed)
    if not cover.classes.keys() & set(_TOLD):
        return fields
    if (entry.action, entry.state) != (NONE, NONE):
        fields[LINKS] = _Links(action=entry.action, state=entry.state)
    action = msgspec.to_builtins(fields.get("action"))
    if isinstance(action, dict):
        del fields["action"]
        others = {name for part in _PARTS if part != ACT for name in _PARTS[part]}
        for part, names in _PARTS.items():
            mine = names if part != ACT else action.keys() - others
            fields[part] = {name: action[name] for name in mine if name in action}
    return fields


def _sealed(
    items: dict[str, bytes], cover: Cover, place: _Where, salts: Callable[[int], bytes]
) -> SealedEnvelope:
    nonce = salts(_NONCE)
    cipher = cover.ciphers.get(place.classes)
    if cipher is None:
        cipher = _cipher(cover.classes[one] for one in place.classes)
        cover.ciphers[place.classes] = cipher
    text = cipher.encrypt(nonce, joined(items), encode_fast(place))
    return SealedEnvelope(keys=cover.keys, nonce=b64(nonce), text=b64(text))


def _cipher(keys: Iterable[bytes]) -> AESGCM:
    """Return the cipher of a box: its key is made of those of all of its classes."""
    return AESGCM(HKDF(SHA256(), _KEY, salt=None, info=_BOX_INFO).derive(b"".join(keys)))
