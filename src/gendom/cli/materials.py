"""`gendom materials`: what ropes, cables and cloths have, with sources."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import tyro

from gendom.files import to_json
from gendom.materials import catalogue


@dataclass(frozen=True, kw_only=True)
class Command:
    """List materials of ropes, cables and cloths, or print all numbers and sources of some.

    E is that of bending, which is what a lift shows. gendom estimate --material takes such a name.

    For example: gendom materials cotton-rope
    """

    names: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="NAME")] = ()
    """Materials; by default all, in short."""
    json: bool = False
    """Print JSON."""
    markdown: bool = False
    """Print a table in Markdown, with every number and a list of sources."""

    def run(self) -> int:
        chosen = [catalogue.get(name) for name in self.names or catalogue.materials()]
        if self.json:
            print(to_json({"materials": [_row(m) for m in chosen], "sources": catalogue.sources()}))
        elif self.markdown:
            print(_table(chosen))
        elif self.names:
            print("\n\n".join(_whole(m) for m in chosen))
        else:
            print(_list(chosen))
        return 0


def _row(material: catalogue.Listed) -> dict:
    about = {"name": material.name, "kind": material.kind, "about": material.about}
    return about | {
        name: {"unit": unit, **asdict(found)} for name, (unit, found) in material.ranges().items()
    }


def _list(chosen: Sequence[catalogue.Listed]) -> str:
    """One line each."""
    wide = max(len(m.name) for m in chosen)
    lines = [f"{'':<{wide}}  {'kind':<5}  {'E in bending [Pa]':<27}  density [kg/m^3]"]
    for m in chosen:
        E = f"{m.E.typical:.2g} ({m.E.low:.2g} to {m.E.high:.2g})"
        rho = f"{m.density.typical:.0f} ({m.density.low:.0f} to {m.density.high:.0f})"
        lines.append(f"{m.name:<{wide}}  {m.kind:<5}  {E:<27}  {rho}")
    return "\n".join([*lines, "gendom materials NAME prints all numbers and their sources."])


def _whole(material: catalogue.Listed) -> str:
    """Every number with its source."""
    lines = [f"{material.name}: {material.about} ({material.kind})"]
    cited = []
    for name, (unit, found) in material.ranges().items():
        unit = "" if unit == "1" else f" {unit}"
        numbers = f"{found.typical:.4g}{unit} ({found.low:.4g} to {found.high:.4g})"
        source = f" [{found.source}]" if found.source else ""
        lines.append(f"  {name:<9}  {numbers:<34}  {found.basis}{source}: {found.how}")
        cited += [found.source] if found.source and found.source not in cited else []
    return "\n".join([*lines, *(f"  [{key}] {_cited(key)}" for key in cited)])


def _table(chosen: Sequence[catalogue.Listed]) -> str:
    """All numbers, each with its source, and the sources."""
    units = [f"{name} [{unit}]" if unit != "1" else name for name, unit in catalogue.UNITS.items()]
    heads = ["material", *units, "across [m]"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    cited, bases = [], {"measured": "", "computed": ", c", "estimate": ", e"}
    for m in chosen:
        cells = [f"`{m.name}`: {m.about}"]
        for _, found in m.ranges().values():
            if found.source and found.source not in cited:
                cited.append(found.source)
            mark = f"[{cited.index(found.source) + 1}]" if found.source else ""
            said = f"{mark}{bases[found.basis]}".removeprefix(", ")
            cells.append(f"{found.typical:.4g} ({found.low:.4g} to {found.high:.4g}) {said}")
        lines.append(f"| {' | '.join(cells)} |")
    listed = (f"{n}. {_cited(key)}" for n, key in enumerate(cited, start=1))
    return "\n".join([*lines, "", *listed])


def _cited(key: str) -> str:
    """A source, and what was found in it."""
    source = catalogue.sources()[key]
    if source.says:
        return f"{source.text}; says: {source.says}"
    return f"{source.text}; not checked: cited for its method or order of magnitude"
