"""The paper's tables with its numbers beside ours."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gendom.evaluation.sheet import Curves, Sheet
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

CLOTH_REAL = {
    "ours": {"cloth-cotton-200mm": 0.78, "cloth-rubber-200mm": 0.98},
    "ours, no parameters": {"cloth-cotton-200mm": 0.52, "cloth-rubber-200mm": 0.97},
}
"""Extended ratios in the paper, of its cotton and its rubber cloth."""

REAL2SIM = {
    "adam": {"rope-cotton": 0.034, "rope-polyester": 0.060, "rope-polyethylene": 0.053},
    "pointnet": {"rope-cotton": 0.092, "rope-polyester": 0.067, "rope-polyethylene": 0.057},
}
"""Chamfer distances of the paper by method, of clouds that are twice as large as the ropes: adam is
its own, pointnet its PointNet++."""


_POLISHED = re.compile(r"polished(, \d+ executions?)?")


def simulated_sheet(title: str, rows: Mapping[str, Any], paper: Mapping[str, float]) -> Sheet:
    """Rows of a simulated table: mean and standard deviation for each number of goals.

    Args:
        title: Of the sheet.
        rows: As `gendom.evaluation.tables.ablation` returns them.
        paper: Means in the paper by a part of the row's name.
    """
    counts = next(iter(rows.values()))
    return Sheet(
        title=title,
        head=(*(["paper"] if paper else []), *(f"{count} goals" for count in counts)),
        rows={
            name: (
                *([_paper_text(name, paper)] if paper else []),
                *(f"{f['mean']:.4f} +- {f['std']:.4f}" for f in figures.values()),
            )
            for name, figures in rows.items()
        },
    )


def _paper_text(name: str, paper: Mapping[str, float]) -> str:
    """The paper's number for a row: its method is the inverse one."""
    rows = (
        f"{v:.3f}" for key, v in paper.items() if name in (f"inverse, {key}", f"{key}, inverse")
    )
    return next(rows, "")


def ablation_sheets(result: Mapping[str, Any], task: str) -> list[Sheet | Curves]:
    """The table, and the error by the number of demonstrations."""
    found: list[Sheet | Curves] = [
        simulated_sheet("Errors, a rope being 0.5 long", result["rows"], ABLATION[task])
    ]
    if fewer := result["by_demonstrations"]:
        found.append(simulated_sheet("By demonstrations", fewer, {}))
        found.append(_by_demonstrations(result))
    return found


def _by_demonstrations(result: Mapping[str, Any]) -> Curves:
    """Of policies that see both, over the largest number of goals."""
    lines: dict[str, tuple[list[float], list[float]]] = {}
    whole = {
        f"{row.partition(', ')[0]}, {result['demonstrations']}": figures
        for row, figures in result["rows"].items()
        if row.endswith(", both") and not row.startswith("polished")
    }
    for row, figures in {**result["by_demonstrations"], **whole}.items():
        method, count = row.split(", ")
        x, y = lines.setdefault(method, ([], []))
        x.append(float(count))
        y.append(list(figures.values())[-1]["mean"])
    return Curves(
        title="Error by the number of demonstrations",
        x="demonstrations",
        y="mean error, a rope being 0.5 long",
        log=True,
        lines=lines,
    )


def generalization_sheets(result: Mapping[str, Any]) -> list[Sheet | Curves]:
    """A table for each domain."""
    return [
        simulated_sheet(domain.capitalize(), rows, GENERALIZATION[domain])
        for domain, rows in result["rows"].items()
    ]


def rope_real_sheets(result: Mapping[str, Any]) -> list[Sheet | Curves]:
    """Estimates, misses of drawn goals, sums over seven goals, components of the errors, and errors
    by the number of executions."""
    drawn = result["drawn"]
    names = list(next(iter(result["estimates"].values())))
    sheets: list[Sheet | Curves] = [
        Sheet(
            title="Estimates (E over density; SI)",
            head=tuple(names),
            rows={
                rope: tuple(f"{estimate[n]['mean']:.4g}" for n in names)
                for rope, estimate in result["estimates"].items()
            },
        ),
        Sheet(
            title=f"{len(drawn['ropes'])} goals, missed by [mm]",
            head=("mean", "median", "std", "worst", "failed"),
            rows={row: _figures(errors) for row, errors in drawn["errors"].items()},
        ),
        Sheet(
            title="Made of [mm]",
            head=tuple(drawn["made_of"]),
            rows={"ours": tuple(f"{1e3 * value:.1f}" for value in drawn["made_of"].values())},
        ),
    ]
    if seven := result.get("seven"):
        short = [rope.removeprefix("rope-") for rope in ROPES]
        sheets.append(
            Sheet(
                title="Seven goals, sums [m]",
                head=(*short, *(f"paper, {rope}" for rope in short)),
                rows={
                    row: (
                        *(f"{_sum(errors, seven['ropes'], rope):.3f}" for rope in ROPES),
                        *(f"{x:.3f}" for x in ROPE_REAL.get(row, ())),
                        *[""] * (0 if row in ROPE_REAL else len(ROPES)),
                    )
                    for row, errors in seven["errors"].items()
                },
            )
        )
    after = [
        e for row, e in drawn["errors"].items() if row.startswith("polished") and "lift" not in row
    ]
    lines = {
        name: (list(range(len(after))), [1e3 * float(of(np.array(e, dtype=float))) for e in after])
        for name, of in (("mean", np.nanmean), ("median", np.nanmedian))
    }
    sheets.append(
        Curves(
            title="Polished, after executions", x="executions", y="missed by [mm]", log=False,
            lines=lines,
        )
    )  # fmt: skip
    return sheets


def _figures(errors: Sequence[float | None]) -> tuple[str, ...]:
    e = 1e3 * np.array(errors, dtype=float)
    done = e[np.isfinite(e)]
    figures = (done.mean(), np.median(done), done.std(), done.max()) if len(done) else ("",) * 4
    texts = (f"{x:.1f}" if x != "" else "" for x in figures)
    return (*texts, str(len(e) - len(done)))


def _sum(errors: Sequence[float | None], ropes: Sequence[str], rope: str) -> float:
    """Over one rope's goals; NaN if one failed."""
    own = [e for e, name in zip(errors, ropes, strict=True) if name == rope]
    return float(np.sum(np.array(own, dtype=float)))


def cloth_real_sheets(result: Mapping[str, Any]) -> list[Sheet]:
    """A table for each cloth."""
    found = []
    for name, rows in result["cloths"].items():
        refused = result["estimates"][name].get("refused")
        found.append(
            Sheet(
                title=f"{name}{f', estimate refused: {refused}' if refused else ''}",
                head=("A", "extended ratio", "std", "paper", "share spread", "std", "failed"),
                rows={row: _spread_texts(name, row, figures) for row, figures in rows.items()},
            )
        )
    return found


def _spread_texts(name: str, row: str, figures: Mapping[str, Any]) -> tuple[str, ...]:
    texts: dict[str, tuple[str, str]] = {}
    for key in ("covered", "share"):
        values = np.array(figures[key], dtype=float)
        done = values[np.isfinite(values)]
        texts[key] = (f"{done.mean():.2f}", f"{done.std():.2f}") if len(done) else ("", "")
    paper = CLOTH_REAL.get(row, {}).get(name)
    return (
        f"{figures['A']:.2f}",
        *texts["covered"],
        "" if paper is None else f"{paper:.2f}",
        *texts["share"],
        str(sum(value is None for value in figures["covered"])),
    )


def real2sim_sheets(result: Mapping[str, Any]) -> list[Sheet]:
    """A table for each object."""
    found = []
    for name, rows in result["objects"].items():
        found.append(
            Sheet(
                title=name,
                head=(
                    "E [Pa]",
                    "truth [Pa]",
                    "error of ln E",
                    "Chamfer [mm]",
                    "paper, halved [mm]",
                    "note",
                ),
                rows={label: _real2sim_texts(name, row) for label, row in rows.items()},
            )
        )
    return found


def _real2sim_texts(name: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    papers = REAL2SIM.get(row["method"], {}).get(name)
    if row["frames"] == "last" and row["method"] != "pointnet":
        papers = None  # the paper's own fits all frames
    paper = "" if papers is None else f"{1e3 * papers / 2.0:.1f}"
    if "skipped" in row:
        return ("", f"{row['truth']:.3g}", "", "", paper, f"skipped: {row['skipped']}")
    return (
        f"{row['E']:.3g}",
        f"{row['truth']:.3g}",
        f"{row['error']:+.3f}",
        f"{1e3 * row['chamfer_last']:.1f}",
        paper,
        "" if row["usable"] else f"not usable: {row['reasons'][0]}",
    )
