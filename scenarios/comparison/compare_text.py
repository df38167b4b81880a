"""A comparison as text: a table, what differs, and a verdict for each measure."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from pickproof.scenarios.comparison.compare import BOUND, Comparison
from pickproof.scenarios.comparison.difference import Difference, points, span
from pickproof.scenarios.results.summary import counted, percent

WORDS = {"success": "pick success", "clearance": "clearance", "cycle": "cycle", "picks_per_hour": "picks an hour"}


def verdict_line(c: Comparison) -> str:
    """The verdict on the pick success, or on first attempts, in a sentence or two."""
    d: Difference = c.success or c.first_attempts
    what = "pick success" if c.basis == "success" else "success of first attempts"
    line = f"{c.verdict}: {what} {percent(d.a)} -> {percent(d.b)}, {points(d.difference)} [{span(d.interval95)}]"
    line += f" points over {counted(c.episodes, 'paired episode')}"
    if c.verdict != "no evidence":
        return line
    show = "no number of episodes within reason" if c.more_to_show is None else f"about {c.more_to_show} more"
    bound = "more than is reasonable" if c.more_to_bound is None else f"about {c.more_to_bound} more"
    return f"{line}; to show a difference of the size seen: {show}; to bound it to {100 * BOUND:.0f} points: {bound}"


def verdict_lines(c: Comparison) -> list[str]:
    """The verdict on each measure but the one of `verdict_line`."""
    lines = []
    for name, verdict in c.verdicts.items():
        d = getattr(c, name)
        if name == c.basis:
            continue
        before, after, difference, bounds = shown(name, d)
        unit = {"cycle": "s", "picks_per_hour": "an hour"}.get(name, "points")
        lines.append(f"{verdict}: {WORDS[name]} {before} -> {after}, {difference} [{bounds}] {unit}")
    return lines


def shown(measure: str, d: Difference) -> tuple[str, str, str, str]:
    """A, B, their difference and its interval as text: points for rates, seconds for the cycle, picks an hour."""
    low, high = d.interval95
    if measure == "cycle":
        return f"{d.a:.2f} s", f"{d.b:.2f} s", f"{d.difference:+.2f}", f"{low:+.2f} to {high:+.2f}"
    if measure == "picks_per_hour":
        return f"{d.a:.0f}", f"{d.b:.0f}", f"{d.difference:+.0f}", f"{low:+.0f} to {high:+.0f}"
    return percent(d.a), percent(d.b), points(d.difference), span(d.interval95)


def differ_line(differ: dict[str, list[Any]]) -> str:
    """As "carry.speed_scale 1.0 -> 0.5, oracle none -> perception"."""
    said = [f"{name} {_value(old)} -> {_value(new)}" for name, (old, new) in differ.items()]
    return f"differ: {', '.join(said) or 'nothing that is recorded'}"


def _value(value: Any) -> str:
    if value is None or value == "" or value == []:
        return "none"
    if isinstance(value, list) and all(isinstance(v, str) for v in value):
        return " + ".join(value)
    text = str(value)
    is_hash = len(text) >= 40 and all(c in "0123456789abcdef" for c in text)
    return text[:10] if is_hash else text


def print_comparison(console: Console, c: Comparison, a: Path, b: Path) -> None:
    """The table, what differs, and the verdicts."""
    table = Table(title=f"A {a}\nB {b}\n{counted(c.episodes, 'paired episode')}", title_justify="left")
    for column in ("", "A", "B", "B - A", "95 %"):
        table.add_column(column, justify="left" if not column else "right")
    for name, words in WORDS.items():
        if (d := getattr(c, name)) is not None:
            table.add_row(words, *shown(name, d))
    table.add_row("first attempts", *shown("success", c.first_attempts))
    for reason, d in c.reasons.items():
        table.add_row(f"  {reason}", *shown("success", d))
    console.print(table)
    f = c.first_attempts
    console.print(
        f"first attempts in identical bins: {f.both} both, {f.only_a} only A, {f.only_b} only B, {f.neither} neither "
        f"(McNemar, exact: p = {f.p:.2g})",
        soft_wrap=True,
    )
    if c.success is None:
        console.print("whole episodes are not compared: the stop rules differ, or one side never moved the arm")
    if c.left_out:
        console.print(f"left out: {c.left_out} episodes that ended in one of the two only")
    console.print(differ_line(c.differ), soft_wrap=True, highlight=False, markup=False)
    for line in (verdict_line(c), *verdict_lines(c)):
        console.print(line, style="bold", soft_wrap=True, highlight=False, markup=False)
