"""A simulator and its motions: shown, and saved as meshes and films."""

import sys

import numpy as np
import pytest

from gendom import viz
from gendom.errors import DeviceError, ParameterError
from gendom.estimation import EstimateSettings, estimate
from gendom.materials import Material
from gendom.sim import Capsule, Cuboid, Gripper, Simulator, Solver, Sphere, Table, cloth, rope
from gendom.viz.simulation import motion_of
from gendom.viz.viewer import Viewer

TIMES = np.array([0.0, 0.1, 0.25])
AROUND = [
    Capsule.between((0.1, -0.1, 0.05), (0.1, 0.1, 0.05), radius=0.02),
    Cuboid(size=(0.1, 0.08, 0.06), rounding=0.01, position=[(0, 0.2, 0), (0, 0.3, 0)], time=[0, 1]),
    Sphere(radius=0.03, position=(0.2, 0.2, 0.2)),
]


def made(body=None, obstacles=AROUND, **more):
    body = body or rope(diameter=0.01, length=0.2, start=(0, 0, 0.1), points=21)
    hand = Gripper.still(body.points[0], radius=0.015)
    return Simulator(body, [Material(E=1e5)] * 2, grippers=[hand], table=Table(height=0.0),
                     obstacles=obstacles, **more)  # fmt: skip


def volume(x, faces):
    """Of what triangles enclose, above 0 if they are counter-clockwise from outside [m^3]."""
    a, b, c = np.moveaxis(x[faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def test_skins_of_obstacles_lie_on_them_and_enclose_them():
    s = made()
    scene = motion_of(s, s.run(TIMES), TIMES)
    sizes = [np.pi * 4e-4 * 0.2 + 4 / 3 * np.pi * 8e-6, 0.1 * 0.08 * 0.06, 4 / 3 * np.pi * 2.7e-5]
    names = ["rope", "capsule 0", "cuboid 1", "sphere 2", "gripper"]
    assert [layer.name for layer in scene.layers] == names
    for of, layer, size in zip(AROUND, scene.layers[1:], sizes, strict=False):
        for k, t in enumerate(TIMES):
            assert np.abs(of.distance(layer.at(k), float(t))).max() < 1e-12
        assert 0.9 < volume(layer.at(0), layer.faces) / size < 1.0
    skin = scene.layers[0]
    assert 0.8 < volume(skin.at(0), skin.faces) / (np.pi * 25e-6 * 0.2) < 1.0


@pytest.mark.parametrize("kind", ["rope", "cloth"])
def test_meshes_have_the_faces_of_the_skin(tmp_path, kind):
    trimesh = pytest.importorskip("trimesh", reason="the extra viz")
    sheet = cloth(width=0.1, height=0.08, thickness=0.001, dx=0.02, corner=(0, 0, 0.2))
    s = made(sheet if kind == "cloth" else None)
    x = s.run(TIMES)
    for form in (".glb", ".obj"):
        viz.save(tmp_path / f"a{form}", s, x, TIMES, world=1)
        found = trimesh.load(tmp_path / f"a{form}", force="scene")
        vertices = np.concatenate([mesh.vertices for mesh in found.dump()])
        if form == ".glb":  # y up
            vertices = vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
            assert set(found.geometry) == {kind, "capsule 0", "cuboid 1", "sphere 2"}
        layers = motion_of(s, x, TIMES, world=1).layers
        points = np.concatenate([of.at(2) for of in layers if of.kind == "surface"])
        for ends in (np.min, np.max):
            np.testing.assert_allclose(ends(vertices, axis=0), ends(points, axis=0), atol=1e-6)


def test_films_last_as_long_as_the_motion(tmp_path):
    cv2, s = pytest.importorskip("cv2", reason="the extra camera"), made()
    viz.save(tmp_path / "a.mp4", s, s.run(TIMES), TIMES)
    film = cv2.VideoCapture(str(tmp_path / "a.mp4"))
    count, rate = film.get(cv2.CAP_PROP_FRAME_COUNT), film.get(cv2.CAP_PROP_FPS)
    assert count == 4 and rate == pytest.approx(10.0)  # as long as the shortest of the motion
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_notebooks_show_a_player(monkeypatch):
    s = made()
    shell = type("Shell", (), {"kernel": None})
    monkeypatch.setitem(sys.modules, "IPython", type("I", (), {"get_ipython": shell}))
    shown = viz.show(s, s.run(TIMES), TIMES)
    page = shown._repr_html_()
    assert page.startswith("<iframe srcdoc=") and len(page) > 30_000


def test_the_viewer_serves_until_it_is_stopped(rope_lift, monkeypatch):
    """Recordings and what was found of them have sliders."""
    found = estimate(rope_lift.seen(), EstimateSettings(starts=1, scene=rope_lift.settings))
    pages = []
    monkeypatch.setattr(Viewer, "serve", lambda viewer: pages.append(viewer.page().decode()))
    for shown in (made(), rope_lift.seen(), found):
        assert viz.show(shown, port=0) is None
    assert '"name":"rope"' in pages[0] and "Reset parameters" not in pages[0]
    assert all("recorded" in page and "Reset parameters" in page for page in pages[1:])
    assert f"&quot;value&quot;: {found.theta.E_over_rho}" in pages[2]
    with pytest.raises(ParameterError, match="simulator must be a Simulator"):
        viz.show(np.zeros((3, 3)), port=0)


def test_particles_are_dots(tmp_path):
    body = rope(diameter=0.02, length=0.06, start=(0, 0, 0.05), cells_across=1.0)
    s = Simulator(body, [Material(E=1e5)], solver=Solver(engine="mpm"))
    assert motion_of(s).layers[0].kind == "dots"
    viz.save(tmp_path / "a.gif", s)
    with pytest.raises(ParameterError, match="particles have no faces"):
        viz.save(tmp_path / "a.obj", s)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("a.stl",), "a.stl: cannot save .stl; choose .glb, .obj, .gif, .mp4"),
        (("a.gif", np.zeros((2, 5, 3))), r"x must be \[T, 21, 3\] or \[T, 2, 21, 3\] numbers"),
        (("a.gif", np.zeros((2, 21, 3)), [1.0, 1.0]), "times: must be 2 that increase"),
    ],
)
def test_what_cannot_be_saved(tmp_path, words, said):
    with pytest.raises(ParameterError, match=said):
        viz.save(tmp_path / words[0], made(), *words[1:])
    with pytest.raises(ParameterError, match="no world 2"):
        viz.save(tmp_path / "a.gif", made(), world=2)
    assert not list(tmp_path.iterdir())


def test_missing_packages_are_named(tmp_path, monkeypatch):
    for name, form, said in (("trimesh", "obj", "viz"), ("cv2", "mp4", "camera")):
        with monkeypatch.context() as without:
            without.setitem(sys.modules, name, None)
            with pytest.raises(DeviceError, match=rf"pip install.*\[{said}\]"):
                viz.save(tmp_path / f"a.{form}", made())
    assert not list(tmp_path.iterdir())
