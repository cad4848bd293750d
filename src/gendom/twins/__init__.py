"""An estimated rope or cloth for other simulators, ready to run there.

A twin is a folder: the scene in the simulator's own form, lift.py, which lifts the object there and
compares every frame with our simulator (with driver.py, which needs NumPy alone), lift.npz with the
numbers that it reads, and twin.json with the parameters and where they come from. lift.py does not
need GenDOM.
"""

from importlib import import_module, resources
from pathlib import Path
from typing import Any

import numpy as np

from gendom.arguments import require
from gendom.errors import GendomError
from gendom.files import atomic_path, write_json
from gendom.materials import Item, to_columns

TARGETS = ("mjcf", "newton", "genesis", "usd")
"""Forms of twins, one module each."""


def write_twin(item: Item, target: str, folder: Path, *, about: dict[str, Any]) -> None:
    """Write the twin of an object.

    Args:
        item: The object.
        target: One of `TARGETS`.
        folder: Made; must not hold a twin.
        about: Where the parameters come from, for twin.json.

    Raises:
        GendomError: The folder holds a twin, or cannot be written.
        DeviceError: A target needs a package that is not installed.
    """
    taken = (folder / "twin.json").exists()
    require(not taken, "holds a twin already", where=str(folder), fix="name another folder",
            error=GendomError)  # fmt: skip
    fix = f"choose {', '.join(TARGETS)}"
    require(target in TARGETS, f"there is no target {target!r}", fix=fix, error=GendomError)
    module = import_module(f"gendom.twins.{target}")
    lift, texts, places, arrays = module.written(item)
    folder.mkdir(parents=True, exist_ok=True)
    if module.SCRIPT:
        scripts = resources.files("gendom.twins") / "scripts"
        for name, script in (("lift.py", module.SCRIPT), ("driver.py", "driver.py")):
            texts[name] = (scripts / script).read_text(encoding="utf-8")
        time, hand = lift.path
        expected = lift.at(lift.simulated(), places)
        arrays |= {"time": time, "hand": hand, "frames": lift.frames, "rest": places}
        with atomic_path(folder / "lift.npz") as temporary:
            np.savez_compressed(temporary, gendom=expected, **arrays)
    for name, text in texts.items():
        with atomic_path(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    said = {"format": "gendom-twin/1", "target": target, "kind": item.kind, "hold": lift.hold}
    write_json(folder / "twin.json", said | {"object": to_columns(item), **about})
