"""Tables for people, the paper's numbers beside ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gendom.evaluation.tables.rope_real import ROPES

ABLATION = {
    "rope-reaching": {"both": 0.024, "E": 0.034, "nu": 0.062, "none": 0.062},
    "rope-casting": {"both": 0.065, "E": 0.067, "nu": 0.077, "none": 0.076},
}
"""Mean errors in the paper, over 30 goals."""

GENERALIZATION = {
    "in domain": {"ours": 0.031, "R2S2R, three ropes": 0.082, "R2S2R, cotton rope": 0.047},
    "outside": {"ours": 0.039, "R2S2R, three ropes": 0.096, "R2S2R, cotton rope": 0.046},
}
"""Mean errors in the paper, over 40 goals."""

ROPE_REAL = {
    "ours": (0.148, 0.106, 0.588),
    "sim+real": (0.112, 0.076, 0.193),
    "pi_RD, ropes": (0.426, 0.273, 0.297),
    "pi_RD, rope": (0.164, 0.512, 0.401),
    "R2S2R, ropes": (0.318, 0.343, 0.364),
    "R2S2R, rope": (0.200, 0.464, 0.473),
}
"""Sums over seven goals in the paper, of its cotton, polyester and polyethylene rope [m]."""


def simulated_text(rows: Mapping[str, Any], paper: Mapping[str, float]) -> str:
    """Rows of a simulated table: mean and standard deviation for each number of goals."""
    counts = list(next(iter(rows.values())))
    width = max(map(len, rows))
    head = "".join(f"{n + ' goals':>20}" for n in counts)
    lines = [f"{'':<{width}}  {'paper' if paper else '':>6}{head}"]
    for name, figures in rows.items():
        said = next((f"{v:.3f}" for key, v in paper.items() if _is_row(name, key)), "")
        cells = "".join(f"{f['mean']:>11.4f} +- {f['std']:.4f}" for f in figures.values())
        lines.append(f"{name:<{width}}  {said:>6}{cells}")
    return "\n".join(lines)


def _is_row(name: str, key: str) -> bool:
    """Whether a row is the one that the paper has, whose method is the inverse one."""
    return name in (f"inverse, {key}", f"{key}, inverse")


def rope_real_text(result: Mapping[str, Any]) -> str:
    """Misses of drawn goals, sums over seven goals, and what errors are made of [mm]."""
    lines = []
    for name, said in result["estimates"].items():
        values = ", ".join(f"{n} {v['mean']:.4g}" for n, v in said.items())
        lines.append(f"{name}: {values} (E over density, damping in s)")
    drawn = result["drawn"]
    width = max(map(len, drawn["errors"]))
    lines.append("")
    lines.append(f"{len(drawn['ropes'])} goals, missed by [mm]")
    lines.append(f"{'':<{width}}{'mean':>8}{'median':>8}{'std':>8}{'worst':>8}{'failed':>8}")
    for row, errors in drawn["errors"].items():
        e = 1e3 * np.array(errors, dtype=float)
        done = e[np.isfinite(e)]
        figures = (done.mean(), np.median(done), done.std(), done.max()) if len(done) else ()
        lines.append(
            f"{row:<{width}}"
            + "".join(f"{x:>8.1f}" for x in figures)
            + f"{int((~np.isfinite(e)).sum()):>8}"
        )
    lines.append(f"made of [mm]: {_made_of(drawn['made_of'])}")
    if seven := result.get("seven"):
        lines.append("")
        lines.append(f"{'seven goals, sums [m]':<{width}}{'':>2}ours{'':>20}paper")
        for row, errors in seven["errors"].items():
            ours = "".join(f"{_sum(errors, seven['ropes'], r):>8.3f}" for r in ROPES)
            said = "".join(f"{x:>8.3f}" for x in ROPE_REAL.get(row, ()))
            lines.append(f"{row:<{width}}{ours}{said}")
    return "\n".join(lines)


def _sum(errors: Sequence[float | None], ropes: Sequence[str], rope: str) -> float:
    """Over one rope's goals; NaN if one failed."""
    own = [e for e, name in zip(errors, ropes, strict=True) if name == rope]
    return float(np.sum(np.array(own, dtype=float)))


def _made_of(parts: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {1e3 * value:.1f}" for name, value in parts.items())
