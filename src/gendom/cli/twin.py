"""`gendom twin`: an estimated object for other simulators."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from gendom.arguments import require
from gendom.cli.arguments import Seed, refuse_sizes
from gendom.cli.outputs import check_places, tell_written
from gendom.errors import GendomError, did_you_mean
from gendom.materials import KINDS, Item, catalogue
from gendom.materials.estimate import Estimate
from gendom.twins import write_twin


@dataclass(frozen=True, kw_only=True)
class Command:
    """Write an estimated rope or cloth for another simulator, with a lift that runs there.

    SOURCE is a file of gendom estimate, or a name of gendom materials with sizes. DIR/lift.py lifts
    the object in that simulator and says how far it is from GenDOM's; it does not need GenDOM. With
    --draws the estimate's uncertainty becomes variants for domain randomisation. See docs/twins.md.

    For example: gendom twin estimate.json --to mjcf --out twin
    """

    source: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SOURCE")]
    """estimate.json, or a material."""
    to: Literal["mjcf", "newton", "genesis", "usd"]
    """mjcf: MuJoCo 4; newton: Newton 1.8; genesis: Genesis 1.4; usd: moving geometry with the
    parameters."""
    out: Path
    """DIR to write; with --draws DIR/000, DIR/001 and so on."""
    draws: int = 0
    """Write so many objects drawn from the estimate, in place of the most likely one."""
    seed: Seed = 0
    length: float | None = None
    """Of a rope of a material [m]."""
    diameter: float | None = None
    """Likewise [m] (default: the usual one)."""
    side: float | None = None
    """Of a cloth of a material [m]."""
    thickness: float | None = None
    """Likewise [m] (default: the usual one)."""
    force: bool = False
    """Accept an estimate that is not usable."""

    def run(self) -> int:
        require(self.draws >= 0, f"is {self.draws}", where="--draws", fix="give 0 or more")
        check_places((self.out, ""))
        if self.source in catalogue.materials():
            what, fix = "needs an estimate: a material has no posterior", "leave it out"
            require(self.draws == 0, what, where="--draws", fix=fix)
            items, about = [self._of_material()], {"source": f"gendom materials {self.source}"}
        else:
            items, about = self._of_estimate()
        folders = [self.out / f"{k:03d}" if self.draws else self.out for k in range(len(items))]
        for k, (item, folder) in enumerate(zip(items, folders, strict=True)):
            write_twin(item, self.to, folder, about=about | {"draw": k if self.draws else None})
        tell_written(self.out)
        if (script := folders[0] / "lift.py").exists():
            print(f"next: python {script}")
        return 0

    @property
    def _sizes(self) -> dict[str, float]:
        """Those that are given."""
        every = {n: getattr(self, n) for n in ("length", "diameter", "side", "thickness")}
        return {name: value for name, value in every.items() if value is not None}

    def _of_material(self) -> Item:
        found = catalogue.get(self.source)
        refuse_sizes(found.kind, self._sizes)
        kind = KINDS[found.kind]
        large, small = kind.sizes
        what, fix = f"a material has no {large}", f"give --{large} in metres"
        require(large in self._sizes, what, where=self.source, fix=fix)
        sizes = {small: found.across.typical, **self._sizes}
        return kind(**sizes, material=found.material(), friction=found.friction.typical)

    def _of_estimate(self) -> tuple[list[Item], dict[str, Any]]:
        path = Path(self.source)
        near = did_you_mean(self.source, catalogue.materials())
        fix = near or "name a file of gendom estimate, or one of gendom materials"
        what = "is no file and no material"
        require(path.exists(), what, where=self.source, fix=fix, error=GendomError)
        given = ", ".join(f"--{name}" for name in self._sizes)
        what = "are sizes of a material; an estimate has its own"
        require(not given, what, where=given, fix="leave them out")
        found = Estimate.load(path, even_unusable=self.force)
        about = {"source": str(path.name), "assumed": found.assumed}
        if not self.draws:
            return [found.item], about
        require(found.names, "has no posterior", where=self.source, fix="leave out --draws")
        return found.draws(self.draws, self.seed), about | {"seed": self.seed}
