"""A cell of simulated devices as a file."""

import re
from pathlib import Path

from gendom.reality import looking_at

CELL = """
robot = "simulated"
address = "rope-cotton"
table_height = 0.0
workspace = [[0.15, -0.6, 0.0], [0.8, 0.6, 0.8]]
[tool]
max_opening = 0.084
latency = 0.0
[speed]
tool = 0.5
share = 0.3
"""


def write_cell(folder: Path, *more: str, cameras: bool = True, **changed: str) -> Path:
    """cell.toml with further tables, and with lines of the first ones changed by their key."""
    text = CELL
    for key, value in changed.items():
        text = re.sub(f"(?m)^{key} = .*", f"{key} = {value}", text)
    for name, side in (("left", 1.0), ("right", -1.0)) if cameras else ():
        T = looking_at((0.95, 0.65 * side, 0.55), (0.45, 0.02, 0.2))
        text += f'[[camera]]\nname = "{name}"\ndevice = "simulated"\nserial = "{name}"\n'
        text += f"T_world_camera = {T.tolist()}\ncalibrated = 2026-11-20\nstated_error = 0.002\n"
    path = folder / "cell.toml"
    path.write_text("\n".join([text, *more]) + "\n", encoding="utf-8")
    return path


def box(name, position, size):
    """A keep-out box."""
    place = [float(x) for x in position]
    return f'[[box]]\nname = "{name}"\nposition = {place}\nsize = {list(size)}'
