"""Sphinx's settings for this documentation; `make docs` builds it into docs/_build."""

from importlib import import_module

import numpy.typing


class ArrayLike:
    """Stands for NumPy's, whose union would fill every signature."""

    __module__ = "numpy.typing"


class NDArray:
    """Stands for NumPy's, of which signatures show `ndarray` only; docstrings give the types."""

    def __class_getitem__(cls, item):
        return numpy.ndarray


numpy.typing.ArrayLike, numpy.typing.NDArray = ArrayLike, NDArray

import gendom  # noqa: E402  after the types that its signatures use

project = "GenDOM"
author = "the GenDOM developers"
release = version = gendom.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"GenDOM {release}"
html_copy_source = False
html_show_sphinx = html_show_copyright = False

myst_heading_anchors = 4
highlight_language = "none"  # of blocks that name no language
default_role = "code"  # single backticks in docstrings

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True}
napoleon_numpy_docstring = False
python_use_unqualified_type_names = True

PACKAGES = (
    "gendom.materials",
    "gendom.sim",
    "gendom.datasets",
    "gendom.estimation",
    "gendom.tasks",
    "gendom.policies",
    "gendom.observation",
    "gendom.perception",
    "gendom.robot",
    "gendom.reality",
    "gendom.viz",
)
"""Packages with a page in docs/api: what their `__all__` names is public."""

CALLED_FIRST = {
    "gendom.datasets": "Recording ObjectDescription Fault generate",
    "gendom.estimation": "estimate replay EstimateSettings SceneSettings Estimate FittedEstimate",
    "gendom.materials": "Material Rope Cloth",
    "gendom.perception": "perceive read_cameras read_ros_bag read_ros_cameras calibrate Camera",
    "gendom.policies": "Policy polish adapt evaluate train",
    "gendom.reality": "find_object record Reality RealWorld RealRope RealCloth",
    "gendom.robot": "find_arm Arm TcpPath plan",
    "gendom.sim": "Simulator rope cloth Gripper Table Physics Solver Targets",
    "gendom.tasks": "RopeReaching RopeCasting ClothSpreading Task Simulation",
    "gendom.viz": "show save write_report write_film",
}
"""What programs call of a package; its page begins with it."""

for _package, _names in CALLED_FIRST.items():
    _module = import_module(_package)
    _first = [name for name in _names.split() if name in _module.__all__]
    _module.__all__ = [*_first, *(name for name in _module.__all__ if name not in _first)]

nitpick_ignore_regex = [("py:.*", r"(?!gendom\.).*")]  # types of other packages


def public_names() -> dict[str, str]:
    """The names under which public objects are documented, by the places that define them."""
    names: dict[str, str] = {}
    for package in (*PACKAGES, "gendom"):
        module = import_module(package)
        for name in module.__all__:
            place = f"{getattr(getattr(module, name), '__module__', None)}.{name}"
            if package == "gendom":  # it has no page
                names[f"gendom.{name}"] = names.get(place, place)
            elif not place.startswith("None."):
                names.setdefault(place, f"{package}.{name}")
    return names


PUBLIC = public_names()


def resolve_alias(app, env, node, contnode):
    """Lead a reference to where an object is documented; internal types are text without a link."""
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py" or not target.startswith("gendom."):
        return None
    if target in PUBLIC:
        domain = env.get_domain("py")
        place = (env, node["refdoc"], app.builder, "obj", PUBLIC[target], node, contnode)
        return domain.resolve_xref(*place)
    return None if target.rpartition(".")[0] in PACKAGES else contnode


def keep_shapes(app, what, name, obj, options, lines):
    """Put back what napoleon takes for the type of an attribute, as in `[T, 3] float64: ...`."""
    types = [line for line in lines if line.startswith(":type: ")]
    if what in ("attribute", "property", "data") and types:
        lines.remove(types[0])
        first = next((k for k, line in enumerate(lines) if line.strip()), 0)
        lines[first] = f"{types[0].removeprefix(':type: ')}: {lines[first]}"


def setup(app):
    """Connect what is defined above."""
    app.connect("missing-reference", resolve_alias)
    app.connect("autodoc-process-docstring", keep_shapes, priority=900)
