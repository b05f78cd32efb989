# SPDX-License-Identifier: Apache-2.0
"""The results as Markdown: what is compared, every timing, the sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

BEGIN, END = "<!-- begin measured -->", "<!-- end measured -->"


def markdown(results: dict[str, Any]) -> str:
    """Return the tables of one run."""
    parts = [
        _about(results),
        targets(results),
        _shown(results),
        _timings(results),
        _sizes(results),
        storage(results["log"]["storage"]),
        _tokens("token of the shipped mission, by signature", results["tokens"]),
        _tokens("token of a mission that grows, by what it holds", results["missions"]),
    ]
    return "\n\n".join(parts) + "\n"


def log_alone(results: dict[str, Any]) -> str:
    """Return the tables of a run of the log alone."""
    parts = [
        _about(results),
        targets(results),
        _shown(results),
        _timings(results),
        storage(results["log"]["storage"]),
    ]
    return "\n\n".join(parts) + "\n"


def write(path: Path, text: str, *, begin: str = BEGIN, end: str = END) -> None:
    """Write the tables to a file; in a page with marks, only between them."""
    page = path.read_text("utf-8") if path.is_file() else ""
    head, begins, rest = page.partition(begin)
    _, ends, tail = rest.partition(end)
    if begins and ends:
        text = f"{head}{begin}\n{text}{end}{tail}"
    path.write_text(text, "utf-8")


def _about(results: dict[str, Any]) -> str:
    machine, libraries = results["machine"], results["libraries"]
    named = ", ".join(f"{name} {number}" for name, number in libraries.items())
    changed = " with changes in `src`" if results["changed_since_commit"] else ""
    return (
        f"Measured {results['date']} at commit `{results['commit'][:12]}`{changed}, "
        f"{results['effort']} run: {machine['cores']} cores {machine['cpu']} "
        f"({machine['architecture']}), {machine['system']}, {machine['file_system']}, "
        f"{results['python']}, SQLite {results['sqlite']}, {named}."
    )


def targets(results: dict[str, Any]) -> str:
    """Return what has a target, with what was measured."""
    lines = ["| compared | measured | target | meets |", "|---|---:|---:|---|"]
    for figure in results["figures"]:
        if figure["target"] is None:
            continue
        target = _value(figure["target"], figure["unit"])
        if not isinstance(figure["target"], bool):
            target = f"<= {target}"
        if figure["moonshot"] is not None:
            target += f" (moonshot {_value(figure['moonshot'], figure['unit'])})"
        measured = _value(figure["value"], figure["unit"])
        meets = "yes" if figure["meets"] else "**no**"
        meets += "" if figure["steady"] else " (unsteady machine: run it again)"
        lines.append(f"| {figure['what']} | {measured} | {target} | {meets} |")
    return "\n".join(lines)


def _shown(results: dict[str, Any]) -> str:
    lines = ["| also measured | |", "|---|---:|"]
    lines += [
        f"| {figure['what']} | {_value(figure['value'], figure['unit'])}"
        f"{'' if figure['steady'] else ' (unsteady)'} |"
        for figure in results["figures"]
        if figure["target"] is None
    ]
    return "\n".join(lines)


def _timings(results: dict[str, Any]) -> str:
    lines = ["| timing (microseconds) | p50 | p95 | p99 | samples |", "|---|---:|---:|---:|---:|"]
    lines += [
        f"| `{name}` | {row['p50_us']:.1f} | {row['p95_us']:.1f} | {row['p99_us']:.1f} "
        f"| {row['samples']} |"
        for name, row in results["timings"].items()
    ]
    return "\n".join(lines)


def _sizes(results: dict[str, Any]) -> str:
    lines = ["| size | bytes |", "|---|---:|"]
    lines += [
        f"| {name.removesuffix('_bytes').replace('_bytes', '').replace('_', ' ')} | {size} |"
        for name, size in results["sizes"].items()
    ]
    return "\n".join(lines)


def storage(rows: list[dict[str, Any]]) -> str:
    """Return the log's bytes by where they lie."""
    lines = [
        "| storage of the log (bytes) | open | sealed | link | tree and notes | together |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        parts = [row[name] for name in ("open", "sealed", "link", "tree")]
        sizes = " | ".join(str(round(size, 2)) for size in (*parts, sum(parts)))
        lines.append(f"| {row['what']} | {sizes} |")
    return "\n".join(lines)


def _tokens(what: str, rows: list[dict[str, Any]]) -> str:
    """Return token sizes: with its chain and with a key id for it, raw and compressed."""
    lines = [
        f"| {what} (bytes) | signed payload | with chain | compressed | with key id | compressed |",
        "|---|---:|---:|---:|---:|---:|",
    ]
    for row in rows:
        name = ", ".join(row[key] for key in ("mission", "signature") if key in row)
        sizes = ("payload", "chain", "chain_zlib", "key_id", "key_id_zlib")
        lines.append(f"| {name} | {' | '.join(str(row[size]) for size in sizes)} |")
    return "\n".join(lines)


def _value(value: Any, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not unit:
        return f"{value:.0f}"
    return f"{value:.3f} {unit}" if unit == "ms" else f"{value:.2f} {unit}"
