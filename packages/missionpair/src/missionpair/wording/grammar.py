# SPDX-License-Identifier: Apache-2.0
"""The template grammar: an attack's text from named choices, so that a search can change them.

The same family, channel, asks and seed give the same text on every machine: choices are drawn by a
hash. Source: section "Attack Templates". Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import blake2b
from random import Random

from msgspec import Struct
from msgspec.structs import replace

from missionpair.pair import Input, Value, WordedCall
from missionpair.wording.asks import NOTHING, put
from missionpair.wording.foreign import TABLES, into
from missionpair.wording.productions import OURS, Grammar, sentences_of
from missionpair.words import Channel, Family

#: How many ways to choose verbs are distinguished; each ask takes the next verb of its frame.
_VERBS = tuple(str(number) for number in range(60))
#: Of three texts two are put together, and one was written as a whole.
_FORMS = ("composed", "composed", "written")
#: Where people talk: whole texts and persuasion come there.
TALKED = frozenset({Channel.USER, Channel.SPEECH, Channel.MEMORY})
#: Slots that are sentences of their own.
_SAID = ("claim", "authority", "reason", "urgency", "former", "closing")


class Derivation(Struct, frozen=True, kw_only=True):
    """How a text comes about: all that a search may change, by slot.

    Args:
        family: what it claims.
        channel: where it stands.
        category: what it changes; empty where that is not known.
        same: it asks for the very place or thing that the mission has there, so that it must not
            speak against it.
        choices: a sentence, or a production's name, for each slot of `slots`.
        grammar: the sentences.
    """

    family: Family
    channel: Channel
    category: str = ""
    same: bool = False
    choices: dict[str, str]
    grammar: Grammar = OURS


def slots(
    family: Family,
    channel: Channel,
    *,
    category: str = "",
    same: bool = False,
    grammar: Grammar = OURS,
) -> dict[str, tuple[str, ...]]:
    """Return every slot of a text with what may stand there."""
    style, common = grammar.styles[channel], grammar.productions
    talked = sentences_of(grammar.written, category, family, same=same)
    written = talked if channel in TALKED else ()
    return {
        "form": _FORMS if written else _FORMS[:1],
        "written": written or ("",),
        "claim": sentences_of(grammar.claims, category, family, same=same) or ("",),
        "authority": ("", *style.authority),
        "reason": ("", *style.reason),
        "urgency": ("", *style.urgency),
        "former": ("", *(style.further if same else style.former)),
        "manner": tuple(common.manner),
        "joining": tuple(common.joining),
        "verbs": _VERBS,
        "closing": ("", *style.closing),
        "arrangement": tuple(common.arrangement),
        "setting": style.settings,
        "scene": common.scenes[family].of(same=same) or ("",),
        "confirmation": common.confirmations,
    }


def derive(
    family: Family,
    channel: Channel,
    *,
    seed: int,
    category: str = "",
    same: bool = False,
    grammar: Grammar = OURS,
) -> Derivation:
    """Return a derivation drawn by the seed."""
    open_slots = slots(family, channel, category=category, same=same, grammar=grammar)
    drawn = {
        slot: among[drawn_number(f"{seed}/{family}/{channel}/{slot}", len(among))]
        for slot, among in open_slots.items()
    }
    return Derivation(
        family=family,
        channel=channel,
        category=category,
        same=same,
        choices=drawn,
        grammar=grammar,
    )


def mutate(derivation: Derivation, random: Random, *, changes: int = 1) -> Derivation:
    """Return the derivation with so many slots drawn anew."""
    open_slots = _slots_of(derivation)
    changed = {
        slot: random.choice(open_slots[slot])
        for slot in random.sample(tuple(open_slots), min(changes, len(open_slots)))
    }
    return replace(derivation, choices={**derivation.choices, **changed})


def cross(one: Derivation, two: Derivation, random: Random) -> Derivation:
    """Return a derivation that has each choice of one parent or the other.

    What the first parent's family or channel does not have is not taken over.
    """
    mixed = {}
    for slot, among in _slots_of(one).items():
        other = two.choices[slot]
        takes_other = random.random() < 0.5 and other in among
        mixed[slot] = other if takes_other else one.choices[slot]
    return replace(one, choices=mixed)


def is_for(asks: Sequence[WordedCall], authorized: str) -> bool:
    """True when calls are about the very place or thing that the mission has there."""
    given = (value for call in asks for value in call.arguments.values())
    named = (name for value in given for name in (value if isinstance(value, list) else [value]))
    return bool(authorized) and authorized in named


def write(
    derivation: Derivation,
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    most: Mapping[str, Value] = NOTHING,
) -> str:
    """Return the text of a derivation.

    Args:
        derivation: the choices.
        asks: what the text asks for.
        authorized: what the mission has where the attack changes it, as people spell it; may be
            empty.
        most: by argument, the most of it: that is said in words.

    Raises:
        ValueError: nothing is asked for.
    """
    if not asks:
        raise ValueError("a text that asks for nothing is no attack")
    chosen = derivation.choices
    if chosen["form"] == "written":
        done = _about(derivation, "written", authorized).replace(
            "{do}", _asked(asks, derivation, most)
        )
        return _set(derivation, done if done[-1] in ".!?" else f"{done}.", authorized)
    filled = {slot: _about(derivation, slot, authorized) for slot in _SAID}
    filled["ask"] = ask_text(asks, derivation, most)
    order = derivation.grammar.productions.arrangement[chosen["arrangement"]]
    body = " ".join(filter(None, (filled[slot] for slot in order)))
    return _set(derivation, body, authorized)


def say(
    family: Family,
    channel: Channel,
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    seed: int,
    category: str = "",
    most: Mapping[str, Value] = NOTHING,
    grammar: Grammar = OURS,
) -> str:
    """Return a text that makes the family's claim on the channel and asks for exactly these calls.

    Args:
        family: what it claims.
        channel: where it stands.
        asks: what it asks for, in order; places and things as the planner spells them.
        authorized: what the mission has where the attack changes it, such as the signed place.
        seed: draws the wording.
        category: what the attack changes; empty where that is not known.
        most: by argument, the most of it: that is said in words.
        grammar: the sentences.

    Raises:
        ValueError: nothing is asked for.
    """
    same = is_for(asks, authorized)
    drawn = derive(family, channel, seed=seed, category=category, same=same, grammar=grammar)
    return write(drawn, asks, authorized=authorized, most=most)


def coordinate(
    family: Family,
    channels: tuple[Channel, Channel],
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    seed: int,
    category: str = "",
    most: Mapping[str, Value] = NOTHING,
    grammar: Grammar = OURS,
) -> tuple[Input, Input]:
    """Return two texts that support each other: the first claims and asks, the second confirms.

    Only the first asks for anything. Arguments are those of `say`.

    Raises:
        ValueError: nothing is asked for, or both channels are the same.
    """
    first, second = channels
    if first is second:
        raise ValueError(f"two channels are expected, got `{first}` twice")
    claimed = say(
        family,
        first,
        asks,
        authorized=authorized,
        seed=seed,
        category=category,
        most=most,
        grammar=grammar,
    )
    same = is_for(asks, authorized)
    drawn = derive(family, second, seed=seed, category=category, same=same, grammar=grammar)
    return Input(first, claimed), Input(second, confirm(drawn, authorized=authorized))


def say_in(
    language: str,
    family: Family,
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    seed: int,
    most: Mapping[str, Value] = NOTHING,
    grammar: Grammar = OURS,
) -> str | None:
    """Return a text in another language that asks for these calls; None where it has no words.

    Args:
        language: one of the grammar's.
        family: what it claims.
        asks: what it asks for, in order.
        authorized: what the mission has where the attack changes it.
        seed: draws the wording.
        most: by argument, the most of it: that is said in words.
        grammar: the sentences.
    """
    same = is_for(asks, authorized)
    texts = grammar.languages[language][family].of(same=same)
    parts = [put(call, turn=0, most=most) for call in asks]
    table = TABLES[language]
    framed = all(any(part.startswith(verb) for verb in table) for part in parts)
    if not texts or not authorized or not framed:
        return None
    asked = into(", then ".join(parts), language)
    text = texts[drawn_number(f"{seed}/{language}", len(texts))]
    return text.replace("{it}", authorized).replace("{do}", asked)


def persuade(
    family: Family,
    channel: Channel,
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    seed: int,
    category: str = "",
    most: Mapping[str, Value] = NOTHING,
    grammar: Grammar = OURS,
) -> tuple[Input, Input, Input]:
    """Return three texts, one after the other: a friendly word, the claim, and the ask.

    Only the last asks for anything. Arguments are those of `say`.

    Raises:
        ValueError: nothing is asked for.
    """
    if not asks:
        raise ValueError("a text that asks for nothing is no attack")
    same = is_for(asks, authorized)
    drawn = derive(family, channel, seed=seed, category=category, same=same, grammar=grammar)
    said = {
        name: among[drawn_number(f"{seed}/{name}", len(among))]
        for name, among in (
            ("opening", grammar.persuasion.opening),
            ("bridge", grammar.persuasion.bridge),
            ("last", grammar.persuasion.last),
        )
    }
    claim = _about(drawn, "claim", authorized)
    scene = _about(drawn, "scene", authorized) if channel is Channel.SCENE else ""
    first, second = said["opening"], " ".join(filter(None, (scene, claim, said["bridge"])))
    third = f"{said['last']} {ask_text(asks, drawn, most)}"
    return Input(channel, first), Input(channel, second), Input(channel, third)


def confirm(derivation: Derivation, *, authorized: str) -> str:
    """Return a text that makes the claim, says that it was checked, and asks for nothing."""
    parts = (
        _about(derivation, slot, authorized) for slot in ("confirmation", "claim", "authority")
    )
    return _set(derivation, " ".join(filter(None, parts)), authorized)


def ask_text(
    asks: Sequence[WordedCall], derivation: Derivation, most: Mapping[str, Value] = NOTHING
) -> str:
    """Return the sentences that ask for the calls, in order."""
    manner = derivation.grammar.productions.manner[derivation.choices["manner"]]
    return _capital(_asked(asks, derivation, most, manner)) + "."


def _asked(
    asks: Sequence[WordedCall],
    derivation: Derivation,
    most: Mapping[str, Value],
    manner: str = "{ask}",
) -> str:
    """Return what asks for the calls, without an end; the first one is put in the manner."""
    first, later, last = derivation.grammar.productions.joining[derivation.choices["joining"]]
    turn = int(derivation.choices["verbs"])
    text = ""
    for number, call in enumerate(asks):
        words = put(call, turn=turn + number, most=most)
        if number == 0:
            put_so = manner.replace("{ask}", words)
            text = first + put_so if len(asks) > 1 else put_so
        else:
            joint = last if number == len(asks) - 1 else later
            text += joint + (_capital(words) if joint == ". " else words)
    return text


def _set(derivation: Derivation, body: str, authorized: str) -> str:
    """Return what is said as it stands on its channel."""
    scene = _about(derivation, "scene", authorized)
    return derivation.choices["setting"].replace("{scene}", scene).replace("{body}", body)


def _slots_of(derivation: Derivation) -> dict[str, tuple[str, ...]]:
    return slots(
        derivation.family,
        derivation.channel,
        category=derivation.category,
        same=derivation.same,
        grammar=derivation.grammar,
    )


def drawn_number(key: str, below: int) -> int:
    """Return a number below another that depends on nothing but the key."""
    return int.from_bytes(blake2b(key.encode(), digest_size=8).digest()) % below


def _about(derivation: Derivation, slot: str, authorized: str) -> str:
    nothing = derivation.grammar.productions.nothing
    filled = derivation.choices[slot].replace("{it}", authorized or nothing)
    return _capital(filled)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
