"""Published tests of rods and shells: curves of theory, and what is simulated, as SVG.

python benchmarks/master_curves.py docs/images/master-curves.svg
"""

import argparse
import io
import math
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from validation import Bench, bending, buckling, elastica

# From Okabe and Ito's palette.
ROD_COLOR, STRIP_COLOR, INK, SOFT_INK = "#009E73", "#D55E00", "#222222", "#6e6e6e"

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 10.0,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#bbbbbb",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "grid.color": "#eaeaea",
    "grid.linewidth": 0.8,
    "xtick.color": SOFT_INK,
    "ytick.color": SOFT_INK,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "svg.fonttype": "path",  # the reader's machine may have other fonts
    "svg.hashsalt": "gendom",  # otherwise random names inside the file
}

TORSION = 1.0 / (1.0 + bending.STIFF.nu)
HANGING = -math.pi / 2.0

RODS: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 5, "color": ROD_COLOR}
STRIPS: dict[str, Any] = RODS | {"marker": "D", "color": STRIP_COLOR}
SQUARES: dict[str, Any] = RODS | {"marker": "s"}
THEORY: dict[str, Any] = {"color": INK, "linewidth": 1.2}


def sags(axes: Axes, bench: Bench) -> None:
    loads = np.geomspace(0.1, 1000.0, 60)
    axes.loglog(loads, elastica.sag(loads), **THEORY, label="theory")
    loads = np.geomspace(0.1, 1000.0, 13)
    axes.loglog(loads, bending.sags(bench, "rods", loads, 65), **RODS, label="rods")
    loads = np.geomspace(0.16, 300.0, 12)
    found = bending.sags(bench, "strips", loads, 49)
    axes.loglog(loads, found, **STRIPS, label="shells", fillstyle="none")
    axes.set(title="Level cantilever: drop over reach of the tip", xlabel="weight [E I / L³]")
    axes.legend(loc="upper left")


def curls(axes: Axes, bench: Bench) -> None:
    tests = (
        (0.0, "clamped level", "-", RODS, (3.7, 6.3), (4.0, 4.5, 5.0, 5.5, 6.0)),
        (HANGING, "hanging", (0, (4, 2)), SQUARES, (5.8, 6.3), (5.95, 6.0, 6.1, 6.2)),
    )
    for angle, name, dashes, points, (low, high), some in tests:
        curvatures, loads = np.linspace(low, high, 24), np.linspace(0.5, 36.0, 72)
        sign = np.array([plane(curvature, angle, loads) for curvature in curvatures])
        axes.contour(
            curvatures, loads, sign.T, levels=[0.0], colors=[THEORY["color"]], linewidths=1.2,
            linestyles=[dashes],
        )  # fmt: skip
        axes.plot([], [], linestyle=dashes, **THEORY, label=f"theory, {name}")
        found = []
        for curvature in some:
            row = plane(curvature, angle, loads)
            for k in np.flatnonzero(row[:-1] * row[1:] < 0.0):
                between = (float(loads[k]), float(loads[k + 1]))
                load = elastica.critical_load(
                    between, curvature=curvature, angle=angle, torsion=TORSION
                )
                share = buckling.curl_leaves(bench, load, curvature, angle, 65)
                found.append((curvature, load * share))
        axes.plot(*np.array(found).T, **points, label=f"rods, {name}")
    axes.set(
        title="Curl: weight at which it leaves its plane [E I / L³]",
        xlabel="natural curvature times length [rad]",
        ylim=(0.0, 40.0),
    )
    axes.legend(loc="upper left")


def plane(curvature: float, angle: float, loads: np.ndarray) -> np.ndarray:
    """Signs and sizes of the determinant along a path of loads."""
    shapes = elastica.hung(loads, curvature=curvature, angle=angle)
    return np.array(
        [
            elastica.leaves_plane(shape, load, curvature, TORSION)
            for shape, load in zip(shapes, loads, strict=True)
        ]
    )


def tips(axes: Axes, bench: Bench) -> None:
    lowered = np.linspace(0.005, 0.32, 64)
    friction = np.array([0.08, 0.1, 0.13, 0.16, 0.2, 0.24, 0.28, 0.32])
    for load, dashes, points in ((0.0, "-", RODS), (10.0, (0, (4, 2)), SQUARES)):
        label = f"weight {load:g} E I / L³"
        theory = elastica.tip_friction(load, lowered)
        axes.plot(lowered, theory, linestyle=dashes, **THEORY, label=f"theory, {label}")
        found = buckling.slips(bench, load, friction)
        axes.plot(found, friction, **points, label=f"rods, {label}")
    axes.set(
        title="Upright rope let down: friction at which its tip slips",
        xlabel="let down over length",
    )
    axes.legend(loc="upper left")


@matplotlib.rc_context(STYLE)
def draw(bench: Bench) -> bytes:
    figure = Figure(figsize=(15.0, 4.2), layout="constrained")
    panels = figure.subplots(1, 3)
    for axes, panel in zip(panels.flat, (sags, curls, tips), strict=True):
        axes.spines[["top", "right"]].set_visible(False)
        panel(axes, bench)
    buffer = io.BytesIO()
    # Date and program version would make the same chart another file each time.
    FigureCanvasSVG(figure).print_svg(buffer, metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--threads", type=int)
    args = parser.parse_args()
    args.out.write_bytes(draw(Bench(engine="thin", threads=args.threads)))


if __name__ == "__main__":
    main()
