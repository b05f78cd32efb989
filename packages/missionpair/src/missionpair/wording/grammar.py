# SPDX-License-Identifier: Apache-2.0
"""The template grammar: an attack's text from named choices, so that a search can change them.

The same family, channel, asks and seed give the same text on every machine: choices are drawn by a
hash. Source: section "Attack Templates". Spec page: docs/spec/missionpair-access.md#wording
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import blake2b
from random import Random

from msgspec import Struct
from msgspec.structs import replace

from missionpair.pair import Input, WordedCall
from missionpair.wording.asks import put
from missionpair.wording.productions import PRODUCTIONS
from missionpair.words import Channel, Family

#: How many ways to choose verbs are distinguished; each ask takes the next verb of its frame.
_VERBS = tuple(str(number) for number in range(60))


class Derivation(Struct, frozen=True, kw_only=True):
    """How a text comes about: all that a search may change, by name.

    Args:
        family: what it claims.
        channel: where it stands.
        choices: a production for each slot of `slots`.
    """

    family: Family
    channel: Channel
    choices: dict[str, str]


def slots(family: Family, channel: Channel) -> dict[str, tuple[str, ...]]:
    """Return every slot of a text with the names of its productions."""
    return {
        "claim": tuple(PRODUCTIONS.claims[family]),
        "authority": tuple(PRODUCTIONS.authority),
        "reason": tuple(PRODUCTIONS.reason),
        "urgency": tuple(PRODUCTIONS.urgency),
        "former": tuple(PRODUCTIONS.former),
        "manner": tuple(PRODUCTIONS.manner),
        "joining": tuple(PRODUCTIONS.joining),
        "verbs": _VERBS,
        "closing": tuple(PRODUCTIONS.closing),
        "arrangement": tuple(PRODUCTIONS.arrangement),
        "setting": tuple(PRODUCTIONS.settings[channel]),
        "scene": tuple(PRODUCTIONS.scenes[family]),
        "confirmation": tuple(PRODUCTIONS.confirmations),
    }


def derive(family: Family, channel: Channel, *, seed: int) -> Derivation:
    """Return a derivation drawn by the seed."""
    drawn = {
        slot: names[drawn_number(f"{seed}/{family}/{channel}/{slot}", len(names))]
        for slot, names in slots(family, channel).items()
    }
    return Derivation(family=family, channel=channel, choices=drawn)


def mutate(derivation: Derivation, random: Random, *, changes: int = 1) -> Derivation:
    """Return the derivation with so many slots drawn anew."""
    open_slots = slots(derivation.family, derivation.channel)
    changed = {
        slot: random.choice(open_slots[slot])
        for slot in random.sample(tuple(open_slots), min(changes, len(open_slots)))
    }
    return replace(derivation, choices={**derivation.choices, **changed})


def cross(one: Derivation, two: Derivation, random: Random) -> Derivation:
    """Return a derivation that has each choice of one parent or the other.

    A production that the first parent's family or channel does not have is not taken over.
    """
    open_slots = slots(one.family, one.channel)
    mixed = {}
    for slot, names in open_slots.items():
        other = two.choices[slot]
        takes_other = random.random() < 0.5 and other in names
        mixed[slot] = other if takes_other else one.choices[slot]
    return replace(one, choices=mixed)


def write(derivation: Derivation, asks: tuple[WordedCall, ...], *, authorized: str) -> str:
    """Return the text of a derivation.

    Args:
        derivation: the choices.
        asks: what the text asks for.
        authorized: what the mission has where the attack changes it, as people spell it; may be
            empty.

    Raises:
        ValueError: nothing is asked for.
    """
    if not asks:
        raise ValueError("a text that asks for nothing is no attack")
    chosen = derivation.choices
    sentences = {
        "claim": PRODUCTIONS.claims[derivation.family][chosen["claim"]],
        "authority": PRODUCTIONS.authority[chosen["authority"]],
        "reason": PRODUCTIONS.reason[chosen["reason"]],
        "urgency": PRODUCTIONS.urgency[chosen["urgency"]],
        "former": PRODUCTIONS.former[chosen["former"]],
        "closing": PRODUCTIONS.closing[chosen["closing"]],
    }
    filled = {slot: _about(text, authorized) for slot, text in sentences.items()}
    filled["ask"] = ask_text(asks, derivation)
    order = PRODUCTIONS.arrangement[chosen["arrangement"]]
    body = " ".join(filter(None, (filled[slot] for slot in order)))
    return _set(derivation, body, authorized)


def say(
    family: Family,
    channel: Channel,
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    seed: int,
) -> str:
    """Return a text that makes the family's claim on the channel and asks for exactly these calls.

    Args:
        family: what it claims.
        channel: where it stands.
        asks: what it asks for, in order; places and things as the planner spells them.
        authorized: what the mission has where the attack changes it, such as the signed place.
        seed: draws the wording.

    Raises:
        ValueError: nothing is asked for.
    """
    return write(derive(family, channel, seed=seed), asks, authorized=authorized)


def coordinate(
    family: Family,
    channels: tuple[Channel, Channel],
    asks: tuple[WordedCall, ...],
    *,
    authorized: str,
    seed: int,
) -> tuple[Input, Input]:
    """Return two texts that support each other: the first claims and asks, the second confirms.

    Only the first asks for anything.

    Raises:
        ValueError: nothing is asked for, or both channels are the same.
    """
    first, second = channels
    if first is second:
        raise ValueError(f"two channels are expected, got `{first}` twice")
    claimed = say(family, first, asks, authorized=authorized, seed=seed)
    confirmed = confirm(derive(family, second, seed=seed), authorized=authorized)
    return Input(channel=first, text=claimed), Input(channel=second, text=confirmed)


def confirm(derivation: Derivation, *, authorized: str) -> str:
    """Return a text that makes the claim, says that it was checked, and asks for nothing."""
    family, chosen = derivation.family, derivation.choices
    parts = (
        _about(PRODUCTIONS.confirmations[chosen["confirmation"]], authorized),
        _about(PRODUCTIONS.claims[family][chosen["claim"]], authorized),
        PRODUCTIONS.authority[chosen["authority"]],
    )
    return _set(derivation, " ".join(filter(None, parts)), authorized)


def ask_text(asks: Sequence[WordedCall], derivation: Derivation) -> str:
    """Return the sentences that ask for the calls, in order."""
    chosen = derivation.choices
    manner = PRODUCTIONS.manner[chosen["manner"]]
    first, later, last = PRODUCTIONS.joining[chosen["joining"]]
    turn = int(chosen["verbs"])
    text = ""
    for number, call in enumerate(asks):
        words = put(call, turn=turn + number)
        if number == 0:
            text = first + manner.replace("{ask}", words) if len(asks) > 1 else ""
            text = text or manner.replace("{ask}", words)
        else:
            joint = last if number == len(asks) - 1 else later
            text += joint + (_capital(words) if joint == ". " else words)
    return _capital(text) + "."


def _set(derivation: Derivation, body: str, authorized: str) -> str:
    """Return what is said as it stands on its channel."""
    chosen = derivation.choices
    scene = _about(PRODUCTIONS.scenes[derivation.family][chosen["scene"]], authorized)
    setting = PRODUCTIONS.settings[derivation.channel][chosen["setting"]]
    return setting.replace("{scene}", scene).replace("{body}", body)


def drawn_number(key: str, below: int) -> int:
    """Return a number below another that depends on nothing but the key."""
    return int.from_bytes(blake2b(key.encode(), digest_size=8).digest()) % below


def _about(text: str, authorized: str) -> str:
    filled = text.replace("{it}", authorized or PRODUCTIONS.nothing)
    return _capital(filled)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
