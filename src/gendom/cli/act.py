"""`gendom act`: the action that reaches a goal with a given object."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from gendom.errors import GendomError
from gendom.files import read_json, to_json, write_json
from gendom.materials import Material

if TYPE_CHECKING:
    pass

_ESTIMATE = "gendom-estimate/1"
_ACTION = "gendom-action/1"

_NEEDED_SIZES = ("length", "diameter")
_PARAMETERS = ("youngs_modulus", "poissons_ratio", "density", "specific_modulus")

# What is missing -> the flags that give it.
_FLAGS = {
    "specific_modulus": "--E and --density",
    "poissons_ratio": "--nu",
    "length": "--length",
    "diameter": "--diameter",
}


@dataclass(frozen=True, kw_only=True)
class Command:
    """Print the action that reaches a goal with a given object, and the robot's motion.

    The object comes from --params, or from --E, --nu, --density, --length and --diameter; each
    of these flags also replaces what --params says.
    """

    task: Annotated[
        tyro.conf.Positional[Literal["rope-reaching"]], tyro.conf.arg(metavar="rope-reaching")
    ]
    """What is done."""
    goal: float
    """How far from the robot's base the tip shall swing [m]."""
    params: Path | None = None
    """File written by gendom estimate."""
    E: float | None = None
    """Young's modulus [Pa]."""
    nu: float | None = None
    """Poisson's ratio [-]."""
    density: float | None = None
    """Mass density [kg/m^3]."""
    length: float | None = None
    """The rope's length [m]."""
    diameter: float | None = None
    """The rope's diameter [m]."""
    policy: Path | None = None
    """Policy file; by default the one that comes with the package."""
    parameters: bool = True
    """Use the policy of the package that does not see the object's parameters."""
    out: Path | None = None
    """Also write the result, with the robot's motion, to this JSON file."""
    json: bool = False
    """Print JSON."""

    def run(self) -> int:
        from gendom.policies import Policy

        if self.policy is None:
            policy = Policy.pretrained(self.task, parameters=self.parameters)
        elif self.parameters:
            policy = Policy.read(self.policy)
        else:
            raise GendomError(
                "cannot be given together with --policy",
                where="--no-parameters",
                fix="leave one of them out",
            )
        held = self._object(needed=(*_NEEDED_SIZES, *policy.description.conditioned_on))
        action = policy.act(
            self.goal,
            held.get("specific_modulus"),
            held.get("poissons_ratio"),
            length=held["length"],
            diameter=held["diameter"],
        )
        task = policy.task().scaled_to(held["length"], held["diameter"])
        result = {
            "format": _ACTION,
            "task": self.task,
            "goal": action.goal,
            "action": action.as_dict(),
            "object": held,
            "policy": {
                "path": policy.where,
                "method": policy.description.method,
                "conditioned_on": policy.description.conditioned_on,
                "seed": policy.description.training.get("seed"),
            },
            "network_input": {
                "specific_modulus": action.specific_modulus,
                "poissons_ratio": action.poissons_ratio,
            },
            "warnings": action.warnings,
            "trajectory": task.trajectory(action.values),
        }
        if self.out is not None:
            write_json(self.out, result)
        print(to_json(result) if self.json else result_text(result, self.out))
        return 0

    def _object(self, needed: tuple[str, ...]) -> dict[str, float]:
        """What is known of the object, in SI units by name; all that is `needed` is there."""
        held = {} if self.params is None else read_estimate(self.params)
        flags = {
            "youngs_modulus": self.E,
            "poissons_ratio": self.nu,
            "density": self.density,
            "length": self.length,
            "diameter": self.diameter,
        }
        given = {name: value for name, value in flags.items() if value is not None}
        held |= given
        if given.keys() & {"youngs_modulus", "density"}:
            held.pop("specific_modulus", None)  # the file's own, of other numbers
        if "specific_modulus" not in held and {"youngs_modulus", "density"} <= held.keys():
            material = Material(E=held["youngs_modulus"], density=held["density"])
            held["specific_modulus"] = material.specific_modulus
        missing = [_FLAGS[name] for name in needed if name not in held]
        if missing:
            raise GendomError(
                "the object is not fully described",
                where=None if self.params is None else str(self.params),
                fix=f"give {', '.join(missing)}"
                + (", or --params with an estimate" if self.params is None else ""),
            )
        return held


def read_estimate(path: Path) -> dict[str, float]:
    """The numbers of an estimate that a policy needs, as far as it has them.

    Raises:
        GendomError: The file is missing, is no estimate, or a number in it is none.
    """
    estimate = read_json(path)
    if estimate.get("format") != _ESTIMATE:
        raise GendomError(
            f"has format {estimate.get('format')!r}, not {_ESTIMATE!r}",
            where=str(path),
            fix="give a file written by gendom estimate",
        )
    found = {name: estimate.get(name) for name in _PARAMETERS}
    sizes = estimate.get("object")
    if isinstance(sizes, dict):
        if sizes.get("kind", "rope") != "rope":
            raise GendomError(
                f"describes a {sizes['kind']}, the task needs a rope",
                where=str(path),
                fix="give the estimate of a rope",
            )
        found |= {name: sizes.get(name) for name in _NEEDED_SIZES}
    for name, value in found.items():
        if not (value is None or (isinstance(value, (int, float)) and value > 0.0)):
            raise GendomError(
                f"{name} must be a positive number, got {value!r}",
                where=str(path),
                fix="estimate again, or give the number by a flag",
            )
    return {name: float(value) for name, value in found.items() if value is not None}


def result_text(result: dict[str, Any], out: Path | None) -> str:
    """The same for people."""
    motion = result["trajectory"]
    held = result["object"]
    size = f"{held['length']:.4g} m long, {held['diameter']:.4g} m thick"
    if "specific_modulus" in held:
        size += f", E / density {held['specific_modulus']:.4g} m^2/s^2"
    if "poissons_ratio" in held:
        size += f", nu {held['poissons_ratio']:.4g}"
    point = ", ".join(f"{name} {value:.4f} m" for name, value in result["action"].items())
    first, last = (
        "(" + ", ".join(f"{c:.4f}" for c in motion["position"][k]) + ")" for k in (0, -1)
    )
    rows = [
        ("rope", size),
        ("goal", f"{result['goal']:.4g} m"),
        ("action", point),
        ("motion", f"from {first} to {last} m at {motion['speed']:.3g} m/s"),
        ("release", f"at {motion['release_time']:.4f} s"),
        ("policy", result["policy"]["path"]),
    ]
    lines = [result["task"], *(f"  {name:<8} {text}" for name, text in rows)]
    if out is None:
        lines += ["  time [s]   position [m]"]
        lines += [
            f"  {t:<9.4f}  " + "  ".join(f"{c:9.5f}" for c in position)
            for t, position in zip(motion["time"], motion["position"], strict=True)
        ]
    else:
        lines.append(f"  written  {out}")
    return "\n".join(lines)
