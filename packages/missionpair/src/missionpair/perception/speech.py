# SPDX-License-Identifier: Apache-2.0
"""Speech: a text as sound in a synthetic voice, and what a small recognizer hears of it."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from random import Random
from threading import Lock
from typing import Any

from missionpair.perception.tools import PerceptionError, package, package_version, run, version_of

#: Voices, each with the program that has it.
VOICES = {
    "en-us": "espeak-ng",
    "en-gb": "espeak-ng",
    "awb": "flite",
    "rms": "flite",
    "slt": "flite",
}
#: The recognizer hears one sound at a time.
_ONE = Lock()


def voice_of(key: str) -> str:
    """Return the voice that the dice of a key draw; the same for the same key."""
    return Random(f"voice {key}").choice(sorted(VOICES))  # noqa: S311


def spoken(text: str, voice: str) -> bytes:
    """Return a text as it is spoken, as a WAV file.

    Args:
        text: what is said.
        voice: one of `VOICES`.

    Raises:
        PerceptionError: the voice's program is not installed, or it failed.
    """
    with tempfile.TemporaryDirectory(prefix="missionpair-") as folder:
        said, heard = Path(folder) / "said.txt", Path(folder) / "said.wav"
        said.write_text(text, encoding="utf-8")
        if VOICES[voice] == "flite":
            run("flite", "-voice", voice, "-f", str(said), "-o", str(heard))
        else:
            run("espeak-ng", "-v", voice, "-s", "140", "-f", str(said), "-w", str(heard))
        return heard.read_bytes()


def hear(wav: bytes) -> str:
    """Return what the recognizer hears; empty where it hears nothing.

    Raises:
        PerceptionError: the extra `perception` is not installed, or the recognizer failed.
    """
    moonshine, recognizer = package("moonshine_voice"), _recognizer()
    with tempfile.NamedTemporaryFile(suffix=".wav") as file:
        file.write(wav)
        file.flush()
        try:
            sound, rate = moonshine.load_wav_file(file.name)
            with _ONE:
                lines = recognizer.transcribe_without_streaming(sound, rate).lines
        except (ValueError, RuntimeError, moonshine.MoonshineError) as error:
            raise PerceptionError(f"{recognizer_name()}: {error}") from error
    return " ".join(" ".join(line.text for line in lines).split())


def speaker(voice: str) -> str:
    """Return the speaker's name with its version."""
    return version_of(VOICES[voice])


def recognizer_name() -> str:
    """Return the recognizer's name with its version."""
    return f"{package_version('moonshine-voice')} tiny-en"


@cache
def _recognizer() -> Any:
    """Return the recognizer with the model that its package brings."""
    moonshine = package("moonshine_voice")
    model = Path(moonshine.__file__).parent / "assets" / "tiny-en"
    return moonshine.Transcriber(model_path=str(model), model_arch=moonshine.ModelArch.TINY)
