"""`gendom materials`: what ropes, cables and cloths have, with sources."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Annotated

import tyro

from gendom.cli.arguments import Json
from gendom.cli.outputs import columns
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
    json: Json = False

    def run(self) -> int:
        chosen = [catalogue.get(name) for name in self.names or catalogue.materials()]
        if self.json:
            print(to_json({"materials": [_row(m) for m in chosen], "sources": catalogue.sources()}))
        elif self.names:
            print("\n\n".join(_whole(m) for m in chosen))
        else:
            print(_list(chosen))
        return 0


def _row(material: catalogue.Listed) -> dict:
    about = {"name": material.name, "kind": material.kind, "about": material.about}
    ranges = material.ranges().items()
    return about | {name: {"unit": unit, **asdict(found)} for name, (unit, found) in ranges}


def _list(chosen: Sequence[catalogue.Listed]) -> str:
    """One line each."""

    def ends(of: catalogue.Range, form: str) -> list[str]:
        return [f"{x:{form}}" for x in (of.typical, of.low, of.high)]

    rows = [(m.name, m.kind, *ends(m.E, ".1e"), *ends(m.density, ".0f")) for m in chosen]
    head = ("", "kind", "E in bending [Pa]", "from", "to", "density [kg/m^3]", "from", "to")
    return columns(head, rows) + "\ngendom materials NAME prints all numbers and their sources."


def _whole(material: catalogue.Listed) -> str:
    """Every number with its source."""
    lines, cited = [f"{material.name}: {material.about} ({material.kind})"], {}
    for name, (unit, found) in material.ranges().items():
        unit = "" if unit == "1" else f" {unit}"
        numbers = f"{found.typical:.4g}{unit} ({found.low:.4g} to {found.high:.4g})"
        source = f" [{found.source}]" if found.source else ""
        lines.append(f"  {name:<9}  {numbers:<34}  {found.basis}{source}: {found.how}")
        cited |= {found.source: catalogue.sources()[found.source]} if found.source else {}
    unchecked = "not checked: cited for its method or order of magnitude"
    said = {key: f"says: {of.says}" if of.says else unchecked for key, of in cited.items()}
    return "\n".join([*lines, *(f"  [{k}] {of.text}; {said[k]}" for k, of in cited.items())])
